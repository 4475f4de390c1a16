/** Painting: people say what the pixels of a camera image are. What the page calls saved is on the disk. */
import { faint, ofClass } from "./colours.js";
import * as areas from "./regions.js";
import { image, literal, OTHERS_MS, sql, teaching } from "./server.js";

/* global ol */

const $ = (id) => document.getElementById(id);
/** A line drawn by hand keeps the points that are farther from it than this, px. */
const KEPT_PX = 0.5;
/** Areas of the map's labels that cover less of an image are not taken over: `views` gives them away too. */
const LEAST_SHARE = 0.001;

/** What a click on an image does. */
const TOOLS = ["polygon", "stroke", "take", "remove"];

/** The images that a map has: those of its layer of pictures, else those of its keyframes. */
const images = (site, there) => {
  const all = there.has("pictures")
    ? `SELECT session, camera, stamp FROM pictures WHERE site = ${literal(site)}`
    : `SELECT session, i['camera'] AS camera, i['stamp'] AS stamp
       FROM (SELECT session, unnest(images) AS i FROM keyframes WHERE site = ${literal(site)})`;
  return `SELECT session, camera, CAST(CAST(stamp AS BIGINT) AS TEXT) AS stamp FROM (${all}) ORDER BY session, camera, stamp`;
};

const labels = ({ session, camera, stamp }) => `SELECT classes, encode(png, 'base64') AS png FROM label_images
  WHERE session = ${literal(session)} AND camera = ${literal(camera)} AND CAST(stamp AS BIGINT) = ${stamp}`;

/** Whether a map has images to paint on. */
export const can = (there) => ["pictures", "keyframes"].some((layer) => there.get(layer)?.rows);

export class Painting {
  /**
   * @param {{site?: string, version?: number, there: Map<string, object>}} state what is shown
   * @param {{fault: (text: string) => void, author: () => string|undefined}} page
   */
  constructor(state, page) {
    Object.assign(this, { state, page, images: [], at: undefined, classes: [], lying: [], undone: [], isOpen: false });
    for (const [id, doing] of Object.entries({
      "paint-polygon": () => this.draw("polygon"), "paint-stroke": () => this.draw("stroke"), "paint-undo": () => this.undo(),
      "paint-take": () => this.choosing("take"), "paint-remove": () => this.choosing("remove"), "paint-all": () => this.take(this.areas()),
      "paint-before": () => this.step(-1), "paint-next": () => this.step(1), "paint-close": () => this.close(),
    })) $(id).addEventListener("click", doing);
    $("paint-place").addEventListener("change", () => this.show(this.images.find((one) => place(one) === $("paint-place").value)));
    $("paint-at").addEventListener("change", () => this.show(this.here()[Number($("paint-at").value)]));
    $("paint-opacity").addEventListener("input", () => this.proposed?.setOpacity(Number($("paint-opacity").value)));
    $("paint-class").addEventListener("change", () => { this.known([this.class]); $("paint-class").blur(); });
    setInterval(() => { if (this.isOpen && !document.hidden) this.look(); }, OTHERS_MS);
    this.keys = {
      t: () => this.choosing("take"), x: () => this.choosing("remove"), Delete: () => this.choosing("remove"), a: () => this.take(this.areas()),
      p: () => this.draw("polygon"), b: () => this.draw("stroke"), u: () => this.undo(), Enter: () => this.drawing?.finishDrawing(),
      Escape: () => (this.isDrawing ? this.drawing.abortDrawing() : this.close()),
      ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1), "+": () => this.widen(1.25), "-": () => this.widen(0.8),
    };
  }

  get class() {
    return $("paint-class").value.trim();
  }

  get brush() {
    return Number($("paint-brush").value);
  }

  widen(factor) {
    $("paint-brush").value = Math.round(this.brush * factor);
  }

  /** What a key does; true where it does something. */
  pressed(key) {
    const chosen = /^[1-9]$/.test(key) ? this.classes[Number(key) - 1] : undefined;
    const doing = chosen ? () => this.choose(chosen) : this.keys[key];
    doing?.();
    return Boolean(doing);
  }

  /** Opens an image; the first one where none is named. @param {{session: string, camera: string, stamp: string}} [wanted] */
  async open(wanted) {
    const { site, version, there } = this.state;
    try {
      this.images = await sql(images(site, there), version);
    } catch (error) {
      return this.page.fault(error.message);
    }
    if (this.images.length === 0) return this.page.fault("the map has no images");
    this.isOpen = true;
    $("paint").hidden = false;
    this.map ??= new ol.Map({ target: "paint-map", controls: [new ol.control.Zoom()], layers: [] });
    this.map.updateSize();
    const places = [...new Set(this.images.map(place))];
    $("paint-place").replaceChildren(...places.map((name) => new Option(name)));
    return this.show(this.images.find((one) => wanted && same(one, wanted)) ?? this.images[0]);
  }

  close() {
    this.stop();
    this.isOpen = false;
    $("paint").hidden = true;
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

  /** Shows an image with its labels, and what lies on it. */
  async show(one) {
    Object.assign(this, { at: one, isReady: false, undone: [], labels: undefined });
    this.stop();
    const all = this.here();
    $("paint-place").value = place(one);
    Object.assign($("paint-at"), { max: all.length - 1, value: all.indexOf(one) });
    $("paint-name").textContent = `${all.indexOf(one) + 1} of ${all.length}`;
    $("paint-saved").textContent = "";
    $("paint-undo").disabled = true;
    try {
      const { version, there, site } = this.state;
      const picture = new Image();
      picture.src = image(one.session, one.camera, one.stamp, version);
      const [found, said] = await Promise.all([
        there.get("label_images")?.rows ? sql(labels(one), version) : [], teaching([site], one), picture.decode(),
      ]);
      if (this.at !== one) return;
      this.size = [picture.naturalWidth, picture.naturalHeight];
      this.classes = [];
      this.known([...(found[0]?.classes ?? []), ...said.classes, this.class]);
      const proposed = found[0] && (await overlay(found[0]));
      if (this.at !== one) return;
      this.labels = proposed && { ...proposed, classes: found[0].classes };
      for (const id of ["paint-take", "paint-all"]) $(id).disabled = !proposed;
      this.lay(picture.src, proposed?.url);
      this.lie(said.labels);
      $("paint-note").textContent = found[0] ? "The colours are what the map says. Draw where it is wrong, accept where it is right." : "The map says nothing of this image yet.";
      this.isReady = true;
      this.draw("polygon");
    } catch (error) {
      this.page.fault(error instanceof DOMException ? "the image cannot be shown: its log is not there, or nobody here reads such an image" : error.message);
    }
  }

  /** Puts the image and its labels into a view of its own pixels. */
  lay(picture, proposed) {
    const [width, height] = this.size;
    const extent = [0, 0, width, height];
    const projection = new ol.proj.Projection({ code: "image", units: "pixels", extent });
    const still = (url, more) => new ol.layer.Image({ source: new ol.source.ImageStatic({ url, projection, imageExtent: extent, interpolate: false }), ...more });
    this.proposed = proposed && still(proposed, { opacity: Number($("paint-opacity").value) });
    this.paint = new ol.layer.Vector({ source: new ol.source.Vector({ wrapX: false }), style: (feature) => this.style(feature, feature.get("row").shape === "polyline") });
    this.map.setLayers([still(picture), ...(this.proposed ? [this.proposed] : []), this.paint]);
    this.map.setView(new ol.View({ projection, center: [width / 2, height / 2], resolution: 1, showFullExtent: true, minResolution: 0.05, maxResolution: 40 }));
    this.map.getView().fit(extent, { padding: [20, 20, 20, 20] });
  }

  /** How a label, or what is being drawn, looks: a line is as wide as its brush. */
  style(feature, isLine) {
    const { kind = this.class, brush_px: brush } = feature.get("row") ?? {};
    const colour = ofClass(this.classes.indexOf(kind));
    const width = isLine ? (brush ?? this.brush) / this.map.getView().getResolution() : 2;
    return new ol.style.Style({
      stroke: new ol.style.Stroke({ color: isLine ? faint(colour, 0.7) : colour, width, lineCap: "round", lineJoin: "round" }),
      fill: new ol.style.Fill({ color: faint(colour, 0.6) }),
    });
  }

  /** Looks whether somebody else painted here. */
  async look() {
    const { at } = this;
    if (!this.isReady || this.isDrawing || this.saving) return;
    const said = await teaching([this.state.site], at).catch(() => undefined);
    if (!said || this.at !== at || this.isDrawing || this.saving) return;
    if (JSON.stringify(said.labels) !== JSON.stringify(this.lying)) this.lie(said.labels);
  }

  /** Shows what lies on the image, later paint over earlier. */
  lie(all) {
    this.lying = all;
    this.known(all.map(({ kind }) => kind));
    const features = all.map((row) => {
      const points = row.points.map((at) => this.turned(at));
      // A line of one point has no length.
      const line = points.length === 1 ? [points[0], points[0]] : points;
      const made = new ol.Feature(row.shape === "polyline" ? new ol.geom.LineString(line) : new ol.geom.Polygon([[...points, points[0]]]));
      made.set("row", row);
      return made;
    });
    this.paint.getSource().clear();
    this.paint.getSource().addFeatures(features);
  }

  /** From the image's pixels, whose rows go down, to the view's, and back. */
  turned([x, y]) {
    return [x, this.size[1] - y];
  }

  /** Takes in classes that were not known. */
  known(names) {
    this.classes = [...new Set([...this.classes, ...names])].filter(Boolean);
    if (!this.class && this.classes.length) $("paint-class").value = this.classes[0];
    $("paint-classes").replaceChildren(...this.classes.map((name) => new Option(name)));
    $("paint-legend").replaceChildren(...this.classes.map((name, index) => {
      const [item, button, colour] = ["li", "button", "span"].map((kind) => document.createElement(kind));
      colour.style.background = ofClass(index);
      button.append(colour, index < 9 ? `${index + 1} ${name}` : name);
      button.classList.toggle("on", name === this.class);
      button.addEventListener("click", () => this.choose(name));
      item.append(button);
      return item;
    }));
    this.paint?.changed();
  }

  choose(name) {
    $("paint-class").value = name;
    this.known([]);
  }

  /** Stops drawing. */
  stop() {
    if (this.drawing) this.map.removeInteraction(this.drawing);
    Object.assign(this, { drawing: undefined, isDrawing: false });
    for (const id of TOOLS) $(`paint-${id}`).classList.remove("on");
  }

  draw(shape) {
    this.stop();
    if (!this.isReady) return;
    $(`paint-${shape}`).classList.add("on");
    const isLine = shape === "stroke";
    const how = isLine ? { type: "LineString", freehand: true } : { type: "Polygon" };
    const drawing = new ol.interaction.Draw({ ...how, style: (feature) => (feature.getGeometry().getType() === "Point" ? this.point(isLine) : this.style(feature, isLine)), stopClick: true });
    drawing.on("drawstart", () => { this.isDrawing = true; });
    drawing.on("drawabort", () => { this.isDrawing = false; });
    drawing.on("drawend", ({ feature }) => {
      this.isDrawing = false;
      this.drawn(isLine ? feature.getGeometry().simplify(KEPT_PX) : feature.getGeometry());
    });
    this.map.addInteraction(drawing);
    this.drawing = drawing;
  }

  /** The next clicks accept what the map says at a place, or remove what lies there. */
  choosing(tool) {
    this.stop();
    if (!this.isReady || (tool === "take" && !this.labels)) return;
    $(`paint-${tool}`).classList.add("on");
    const handleEvent = ({ type, coordinate, pixel }) => {
      if (type !== "click") return true;
      if (tool === "take") this.take(areas.at(this.areas(), this.turned(coordinate)));
      else this.remove(pixel);
      return false;
    };
    this.drawing = new ol.interaction.Interaction({ handleEvent });
    this.drawing.finishDrawing = this.drawing.abortDrawing = () => {};
    this.map.addInteraction(this.drawing);
  }

  /** The areas of the map's labels, each before what it encloses. */
  areas() {
    if (!this.labels) return [];
    const { values, classes } = this.labels;
    const least = LEAST_SHARE * values.length;
    this.labels.areas ??= areas.regions(values, this.size, (label) => label < classes.length, least);
    return this.labels.areas;
  }

  /** Accepts areas as the map has them: from now on a person says so. */
  take(found) {
    if (!this.isReady || found.length === 0) return undefined;
    return this.say(found.map(({ label, ring }) => ({
      type: "Feature", geometry: { type: "Polygon", coordinates: [ring] },
      properties: { kind: this.labels.classes[label], standing: "drawn" },
    })));
  }

  /** Removes what lies on top at a pixel of the view, whoever painted it. */
  remove(pixel) {
    const row = this.map.forEachFeatureAtPixel(pixel, (found) => found.get("row"), { layerFilter: (made) => made === this.paint });
    if (!row) return undefined;
    return this.say([{ type: "Feature", id: row.label, geometry: null, properties: { kind: row.kind, standing: "removed" } }]);
  }

  /** The pointer: a brush is as large as what it covers. */
  point(isLine) {
    const colour = ofClass(this.classes.indexOf(this.class));
    const radius = isLine ? this.brush / 2 / this.map.getView().getResolution() : 4;
    return new ol.style.Style({ image: new ol.style.Circle({ radius, stroke: new ol.style.Stroke({ color: colour, width: 2 }) }) });
  }

  /** Says what was drawn; what lies beyond the image's edge ends there. */
  drawn(geometry) {
    const isLine = geometry.getType() === "LineString";
    const points = isLine ? geometry.getCoordinates() : geometry.getCoordinates()[0];
    const [width, height] = this.size;
    const within = points.map((at) => this.turned(at)).map(([x, y]) => [Math.min(Math.max(x, 0), width), Math.min(Math.max(y, 0), height)]);
    if (!this.class) return this.page.fault("say which class it is");
    return this.say([{
      type: "Feature", geometry: isLine ? { type: "LineString", coordinates: within } : { type: "Polygon", coordinates: [within] },
      properties: { kind: this.class, standing: "drawn", ...(isLine ? { brush_px: this.brush } : {}) },
    }]);
  }

  /** Says features; they are saved when this returns `true`. */
  async say(features, isUndo = false) {
    const { at } = this;
    this.saving = true;
    $("paint-saved").textContent = "saving …";
    try {
      const answer = await teaching([this.state.site], at, { author: this.page.author(), features: { type: "FeatureCollection", features } });
      if (this.at !== at) return true;
      if (!isUndo) this.undone.push(answer.undo.features);
      $("paint-saved").textContent = `saved; drawn on this image: ${answer.labels.length}`;
      this.lie(answer.labels);
      return true;
    } catch (error) {
      $("paint-saved").textContent = "NOT saved";
      this.page.fault(`not saved: ${error.message}`);
      return false;
    } finally {
      this.saving = false;
      $("paint-undo").disabled = this.undone.length === 0;
    }
  }

  async undo() {
    const features = this.undone.pop();
    if (!features) return;
    if (!(await this.say(features, true))) this.undone.push(features);
    $("paint-undo").disabled = this.undone.length === 0;
  }
}

const place = ({ session, camera }) => `${session}, ${camera}`;
const same = (a, b) => place(a) === place(b) && a.stamp === b.stamp;

/** Labels by pixel, and as a picture of the colours of their classes; clear where a pixel has none. */
async function overlay({ classes, png }) {
  const stored = new Image();
  stored.src = `data:image/png;base64,${png}`;
  await stored.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [stored.naturalWidth, stored.naturalHeight];
  const pen = canvas.getContext("2d");
  pen.drawImage(stored, 0, 0);
  const pixels = pen.getImageData(0, 0, canvas.width, canvas.height);
  const colours = classes.map((_, index) => [1, 3, 5].map((at) => Number.parseInt(ofClass(index).slice(at, at + 2), 16)));
  const values = Uint8Array.from({ length: pixels.data.length / 4 }, (_, index) => pixels.data[4 * index]);
  for (let at = 0; at < pixels.data.length; at += 4) {
    const colour = colours[pixels.data[at]];
    if (colour) pixels.data.set(colour, at);
    else pixels.data[at + 3] = 0;
  }
  pen.putImageData(pixels, 0, 0);
  return { values, url: canvas.toDataURL() };
}
