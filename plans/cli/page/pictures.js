/** Camera images as a whole: one is shown in a view of its own pixels, and the others of its camera are a step away. */
import { image } from "./server.js";

/* global ol */

const place = ({ session, camera }) => `${session}, ${camera}`;

/** Whether two images are the same. */
export const same = (a, b) => place(a) === place(b) && a.stamp === b.stamp;

/** Whether a map has images to show. */
export const can = (there) => ["pictures", "keyframes"].some((layer) => there.get(layer)?.rows);

/** A query for the images that rows of a table name, in the order of time. */
export const listed = (table) =>
  `SELECT session, camera, CAST(CAST(stamp AS BIGINT) AS TEXT) AS stamp FROM (${table}) ORDER BY session, camera, stamp`;

/** Shows images, one at a time. What extends it has `show(one)`, and `keys`. */
export class Viewer {
  /**
   * @param {string} name of its element; the names of its parts begin so: `NAME-map`, `NAME-place`, `NAME-at`, …
   * @param {string[]} tools what a click on an image does; a button each
   * @param {{site?: string, version?: number, there: Map<string, object>}} state what is shown
   * @param {{fault: (text: string) => void}} page
   */
  constructor(name, tools, state, page) {
    Object.assign(this, { name, tools, state, page, images: [], at: undefined, isOpen: false });
    this.part("before").addEventListener("click", () => this.step(-1));
    this.part("next").addEventListener("click", () => this.step(1));
    this.part("close").addEventListener("click", () => this.close());
    this.part("place").addEventListener("change", () => this.show(this.images.find((one) => place(one) === this.part("place").value)));
    this.part("at").addEventListener("change", () => this.show(this.here()[Number(this.part("at").value)]));
    this.keys = {
      Enter: () => this.drawing?.finishDrawing(), Escape: () => (this.isDrawing ? this.drawing.abortDrawing() : this.close()),
      ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
    };
  }

  /** The element of a part. */
  part(name) {
    return document.getElementById(`${this.name}-${name}`);
  }

  /** What a key does; true where it does something. */
  pressed(key) {
    const doing = this.keys[key];
    doing?.();
    return Boolean(doing);
  }

  /** Opens one of these images: the wanted one, or else the first. */
  async begin(images, wanted) {
    this.images = images;
    if (images.length === 0) return this.page.fault("the map has no images");
    this.isOpen = true;
    document.getElementById(this.name).hidden = false;
    this.map ??= new ol.Map({ target: `${this.name}-map`, controls: [new ol.control.Zoom()], layers: [] });
    this.map.updateSize();
    const places = [...new Set(images.map(place))];
    this.part("place").replaceChildren(...places.map((name) => new Option(name)));
    return this.show(images.find((one) => wanted && same(one, wanted)) ?? images[0]);
  }

  close() {
    this.stop();
    this.isOpen = false;
    document.getElementById(this.name).hidden = true;
  }

  /** The images of the camera that is shown, in the order of time. */
  here() {
    return this.images.filter((one) => place(one) === place(this.at));
  }

  step(by) {
    const all = this.here();
    const next = all[all.indexOf(this.at) + by];
    if (next) this.show(next);
  }

  /** Turns to an image, and says which it is. @returns {HTMLImageElement} its picture, which is being read */
  turn(one) {
    Object.assign(this, { at: one, isReady: false });
    this.stop();
    const all = this.here();
    this.part("place").value = place(one);
    Object.assign(this.part("at"), { max: all.length - 1, value: all.indexOf(one) });
    this.part("name").textContent = `${all.indexOf(one) + 1} of ${all.length}`;
    this.part("saved").textContent = "";
    const picture = new Image();
    picture.src = image(one.session, one.camera, one.stamp, this.state.version);
    return picture;
  }

  /** Says why an image is not there. */
  unseen(error) {
    this.page.fault(error instanceof DOMException ? "the image cannot be shown: its log is not there, or nobody here reads such an image" : error.message);
  }

  /**
   * Puts an image, and what lies over it, into a view of its own pixels.
   * @param {HTMLImageElement} picture
   * @param {(still: (url: string, more?: object) => ol.layer.Image) => object[]} over the layers over it; `still` makes one of a
   *   picture of the same size
   */
  lay(picture, over) {
    this.size = [picture.naturalWidth, picture.naturalHeight];
    const [width, height] = this.size;
    const extent = [0, 0, width, height];
    const projection = new ol.proj.Projection({ code: "image", units: "pixels", extent });
    const still = (url, more) => new ol.layer.Image({ source: new ol.source.ImageStatic({ url, projection, imageExtent: extent, interpolate: false }), ...more });
    this.map.setLayers([still(picture.src), ...over(still)]);
    this.map.setView(new ol.View({ projection, center: [width / 2, height / 2], resolution: 1, showFullExtent: true, minResolution: 0.05, maxResolution: 40 }));
    this.map.getView().fit(extent, { padding: [20, 20, 20, 20] });
    // From here on pixels of the page are places of the image.
    this.map.renderSync();
  }

  /** From the image's pixels, whose rows go down, to the view's, and back. */
  turned([x, y]) {
    return [x, this.size[1] - y];
  }

  /** The same, of a place that may lie beyond the image's edge: what does, ends there. */
  within(at) {
    const [width, height] = this.size;
    const [x, y] = this.turned(at);
    return [Math.min(Math.max(x, 0), width), Math.min(Math.max(y, 0), height)];
  }

  /** Stops drawing. */
  stop() {
    if (this.drawing) this.map.removeInteraction(this.drawing);
    Object.assign(this, { drawing: undefined, isDrawing: false });
    for (const tool of this.tools) this.part(tool).classList.remove("on");
  }

  /** Draws with an interaction until another tool is taken; `drawn` hears of each geometry. */
  draws(tool, drawing, drawn) {
    this.stop();
    this.part(tool).classList.add("on");
    drawing.on("drawstart", () => { this.isDrawing = true; });
    drawing.on("drawabort", () => { this.isDrawing = false; });
    drawing.on("drawend", ({ feature }) => {
      this.isDrawing = false;
      drawn(feature.getGeometry());
    });
    this.map.addInteraction(drawing);
    this.drawing = drawing;
  }

  /** Does something with the next clicks, by coordinate and pixel of the view. */
  clicks(tool, doing) {
    this.stop();
    this.part(tool).classList.add("on");
    const handleEvent = ({ type, coordinate, pixel }) => {
      if (type !== "click") return true;
      doing(coordinate, pixel);
      return false;
    };
    this.drawing = new ol.interaction.Interaction({ handleEvent });
    this.drawing.finishDrawing = this.drawing.abortDrawing = () => {};
    this.map.addInteraction(this.drawing);
  }

  /** The row of what lies on top of a layer at a pixel of the view. */
  rowAt(pixel, layer) {
    return this.map.forEachFeatureAtPixel(pixel, (found) => found.get("row"), { layerFilter: (made) => made === layer });
  }
}
