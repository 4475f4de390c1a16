/** Painting: people say what the pixels of a camera image are. What the page calls saved is on the disk. */
import { faint, ofClass } from "./colours.js";
import { listed, Viewer } from "./pictures.js";
import * as areas from "./regions.js";
import { literal, OTHERS_MS, sql, teaching } from "./server.js";

/* global ol */

const $ = (id) => document.getElementById(id);
/** A line drawn by hand keeps the points that are farther from it than this, px. */
const KEPT_PX = 0.5;
/** Areas of the map's labels that cover less of an image are not taken over: `views` gives them away too. */
const LEAST_SHARE = 0.001;

/** What a click on an image does. */
const TOOLS = ["polygon", "stroke", "take", "remove"];

/** The images that a map has: those of its layer of pictures, else those of its keyframes. */
const images = (site, there) => listed(there.has("pictures")
  ? `SELECT session, camera, stamp FROM pictures WHERE site = ${literal(site)}`
  : `SELECT session, i['camera'] AS camera, i['stamp'] AS stamp
     FROM (SELECT session, unnest(images) AS i FROM keyframes WHERE site = ${literal(site)})`);

const labels = ({ session, camera, stamp }) => `SELECT classes, encode(png, 'base64') AS png FROM label_images
  WHERE session = ${literal(session)} AND camera = ${literal(camera)} AND CAST(stamp AS BIGINT) = ${stamp}`;

export class Painting extends Viewer {
  /**
   * @param {{site?: string, version?: number, there: Map<string, object>}} state what is shown
   * @param {{fault: (text: string) => void, author: () => string|undefined}} page
   */
  constructor(state, page) {
    super("paint", TOOLS, state, page);
    Object.assign(this, { classes: [], lying: [], undone: [] });
    for (const [id, doing] of Object.entries({
      "paint-polygon": () => this.draw("polygon"), "paint-stroke": () => this.draw("stroke"), "paint-undo": () => this.undo(),
      "paint-take": () => this.choosing("take"), "paint-remove": () => this.choosing("remove"), "paint-all": () => this.take(this.areas()),
    })) $(id).addEventListener("click", doing);
    $("paint-opacity").addEventListener("input", () => this.proposed?.setOpacity(Number($("paint-opacity").value)));
    $("paint-class").addEventListener("change", () => { this.known([this.class]); $("paint-class").blur(); });
    setInterval(() => { if (this.isOpen && !document.hidden) this.look(); }, OTHERS_MS);
    Object.assign(this.keys, {
      t: () => this.choosing("take"), x: () => this.choosing("remove"), Delete: () => this.choosing("remove"), a: () => this.take(this.areas()),
      p: () => this.draw("polygon"), b: () => this.draw("stroke"), u: () => this.undo(),
      "+": () => this.widen(1.25), "-": () => this.widen(0.8),
    });
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
    if (!chosen) return super.pressed(key);
    this.choose(chosen);
    return true;
  }

  /** Opens an image; the first one where none is named. @param {{session: string, camera: string, stamp: string}} [wanted] */
  async open(wanted) {
    const { site, version, there } = this.state;
    try {
      return await this.begin(await sql(images(site, there), version), wanted);
    } catch (error) {
      return this.page.fault(error.message);
    }
  }

  /** Shows an image with its labels, and what lies on it. */
  async show(one) {
    Object.assign(this, { undone: [], labels: undefined });
    const picture = this.turn(one);
    $("paint-undo").disabled = true;
    try {
      const { version, there, site } = this.state;
      const [found, said] = await Promise.all([
        there.get("label_images")?.rows ? sql(labels(one), version) : [], teaching([site], one), picture.decode(),
      ]);
      if (this.at !== one) return;
      this.classes = [];
      this.known([...(found[0]?.classes ?? []), ...said.classes, this.class]);
      const proposed = found[0] && (await overlay(found[0]));
      if (this.at !== one) return;
      this.labels = proposed && { ...proposed, classes: found[0].classes };
      for (const id of ["paint-take", "paint-all"]) $(id).disabled = !proposed;
      this.put(picture, proposed?.url);
      this.lie(said.labels);
      $("paint-note").textContent = found[0] ? "The colours are what the map says. Draw where it is wrong, accept where it is right." : "The map says nothing of this image yet.";
      this.isReady = true;
      this.draw("polygon");
    } catch (error) {
      this.unseen(error);
    }
  }

  /** Shows the image, and its labels over it. */
  put(picture, proposed) {
    this.paint = new ol.layer.Vector({ source: new ol.source.Vector({ wrapX: false }), style: (feature) => this.style(feature, feature.get("row").shape === "polyline") });
    this.lay(picture, (still) => {
      this.proposed = proposed && still(proposed, { opacity: Number($("paint-opacity").value) });
      return [...(this.proposed ? [this.proposed] : []), this.paint];
    });
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

  draw(shape) {
    this.stop();
    if (!this.isReady) return;
    const isLine = shape === "stroke";
    const how = isLine ? { type: "LineString", freehand: true } : { type: "Polygon" };
    const drawing = new ol.interaction.Draw({ ...how, style: (feature) => (feature.getGeometry().getType() === "Point" ? this.point(isLine) : this.style(feature, isLine)), stopClick: true });
    this.draws(shape, drawing, (geometry) => this.drawn(isLine ? geometry.simplify(KEPT_PX) : geometry));
  }

  /** The next clicks accept what the map says at a place, or remove what lies there. */
  choosing(tool) {
    this.stop();
    if (!this.isReady || (tool === "take" && !this.labels)) return;
    this.clicks(tool, (at, pixel) => (tool === "take" ? this.take(areas.at(this.areas(), this.turned(at))) : this.remove(pixel)));
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
    const row = this.rowAt(pixel, this.paint);
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
    const within = points.map((at) => this.within(at));
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
