/** Teaching: people draw boxes, areas and lines, and answer what the map asks. What the page calls saved is on the disk. */
import { BLUE, GREEN, GREY, VERMILION, YELLOW, faint } from "./colours.js";
import { waiting } from "./people.js";
import { same } from "./pictures.js";
import { box, outline } from "./shapes.js";
import { OTHERS_MS, part, teaching } from "./server.js";

/* global ol */

const $ = (id) => document.getElementById(id);
const KINDS = ["parking_space", "crossing", "stop_line", "arrow", "person"];
const STANDING = { drawn: { colour: GREEN }, accepted: { colour: GREEN }, rejected: { colour: GREY, dashed: true } };

/**
 * Makes the page one that people teach by, where the server lets them.
 * @param {ol.Map} map
 * @param {{site?: string}} state which site is shown
 * @param {{fault: (text: string) => void, images: (at: number[]) => void, clear: () => void}} page
 */
export async function begin(map, state, page) {
  const may = await teaching().catch(() => ({}));
  if (!may.teach) return undefined;
  const taught = new Teaching(map, state, page);
  $("teach").hidden = false;
  $("author-row").hidden = may.author_is_known;
  $("author").value = may.author_is_known ? "" : localStorage.getItem("author") ?? may.author;
  taught.author = () => (may.author_is_known ? undefined : $("author").value.trim() || undefined);
  $("author").addEventListener("change", () => localStorage.setItem("author", $("author").value.trim()));
  await taught.open();
  setInterval(() => { if (!document.hidden) taught.look(); }, OTHERS_MS);
  return taught;
}

const layer = (zIndex) => new ol.layer.Vector({ source: new ol.source.Vector(), zIndex, updateWhileInteracting: true });
const middle = (one) => [one.map_from_label.x, one.map_from_label.y];
/** Of the map around a person as much is shown as around a thing of this size, m. */
const AROUND_M = 3;
/** Which image shows who is asked about, and where; `undefined` of what lies on the ground. */
const shown = ({ image, rectangle }) => image && JSON.stringify([image.session, image.camera, image.stamp, rectangle]);
const near = (a, b) => (a.image || b.image ? shown(a) === shown(b) : Math.hypot(middle(a)[0] - middle(b)[0], middle(a)[1] - middle(b)[1]) < 0.3 * Math.min(a.width_m, a.length_m));

class Teaching {
  constructor(map, state, page) {
    Object.assign(this, { map, state, page, labels: [], revision: 0, asked: [], hypotheses: [], skipped: new Set(), question: undefined, undone: [], chosen: undefined });
    [this.proposed, this.said, this.pointed] = [layer(92), layer(94), layer(96)];
    for (const made of [this.proposed, this.said, this.pointed]) map.addLayer(made);
    $("kinds").replaceChildren(...KINDS.map((kind) => new Option(kind)));
    $("kind").addEventListener("change", () => { this.asked = []; this.ask(undefined); this.rank(); });
    for (const [id, doing] of Object.entries({
      "draw-box": () => this.draw("box"), "draw-area": () => this.draw("area"), "draw-line": () => this.draw("line"),
      accept: () => this.answer("accepted"), reject: () => this.answer("rejected"), skip: () => this.skip(),
      undo: () => this.undo(), remove: () => this.remove(),
    })) $(id).addEventListener("click", doing);
    this.keys = {
      b: () => this.draw("box"), p: () => this.draw("area"), i: () => this.draw("line"), a: () => this.answer("accepted"),
      r: () => this.answer("rejected"), s: () => this.skip(), u: () => this.undo(), Delete: () => this.remove(),
    };
  }

  get kind() {
    return $("kind").value.trim();
  }

  /** Shows a site, and what is asked of it. */
  async open() {
    Object.assign(this, { revision: 0, asked: [], skipped: new Set(), undone: [] });
    $("undo").disabled = true;
    this.ask(undefined);
    this.choose(undefined);
    await this.look();
  }

  /** Looks whether somebody said something. */
  async look() {
    const { site } = this.state;
    if (!site || this.saving) return;
    try {
      const found = await teaching([site]);
      if (site !== this.state.site || found.revision <= this.revision) return;
      this.show(found);
      await this.rank();
    } catch (error) {
      $("saved").textContent = `not connected: ${error.message}`;
    }
  }

  show({ labels, revision }) {
    Object.assign(this, { labels, revision });
    const features = labels.map((row) => {
      const { colour, dashed } = STANDING[row.standing] ?? {};
      const made = outline(row.points, row.shape !== "polyline", { row, colour, dashed, width: row.standing === "rejected" ? 1 : 2 });
      made.set("label", row);
      return made;
    });
    this.said.getSource().clear();
    this.said.getSource().addFeatures(features);
    const kinds = new Set([...KINDS, ...labels.map(({ kind }) => kind)]);
    $("kinds").replaceChildren(...[...kinds].map((kind) => new Option(kind)));
    if (this.chosen && !labels.some(({ label }) => label === this.chosen.label)) this.choose(undefined);
  }

  /** Asks for what may be of the kind: first what was known, weighed again, then what a search finds. */
  async rank() {
    const { kind, revision, state: { site } } = this;
    for (const searched of [false, true]) {
      const found = await teaching([site, kind], { revision, searched }).catch((error) => this.page.fault(error.message));
      if (!found || kind !== this.kind || site !== this.state.site || found.revision < this.revision) return;
      this.rankIs(found);
      if (found.is_searched) return;
    }
  }

  rankIs({ hypotheses, milliseconds, is_searched: isSearched, revision, unplaced = 0, waiting: count = 0 }) {
    this.hypotheses = hypotheses;
    $("waiting").textContent = waiting(count);
    const features = hypotheses.filter(({ probability, question }) => probability >= 0.5 || question).map((row) => {
      const made = box(row.map_from_label, row.length_m, row.width_m, { row, colour: row.probability >= 0.5 ? BLUE : YELLOW, dashed: true, fill: 0.05 + 0.2 * row.probability });
      return made;
    });
    this.proposed.getSource().clear();
    this.proposed.getSource().addFeatures(features);
    this.asked = hypotheses.filter((one) => one.question && !this.skipped.has(shown(one))).sort((a, b) => a.question - b.question);
    const likely = hypotheses.filter(({ probability }) => probability >= 0.5).length;
    Object.assign(this, { ranked: { likely, milliseconds, isSearched, unplaced }, rankedRevision: revision });
    // What a person looks at does not change under their hands, unless it is answered.
    const stays = this.question && this.asked.find((one) => near(one, this.question));
    this.ask(stays ?? this.asked[0], Boolean(stays));
    this.heard?.();
  }

  /** Whom is asked about in an image, those that were skipped too. */
  openIn(shownBy) {
    return this.hypotheses.filter(({ image }) => image && same(image, shownBy));
  }

  /** Shows a question, and the images of its place. */
  ask(question, stays) {
    this.question = question;
    this.pointed.getSource().clear();
    $("answers").hidden = !question;
    const { likely = 0 } = this.ranked ?? {};
    $("question").textContent = question
      ? `Is this a ${this.kind.replaceAll("_", " ")}? ${Math.round(100 * question.probability)} %: ${question.reason}. ${likely} more are likely.`
      : this.nothing();
    this.lookAt(question);
    if (!question) return;
    this.pointed.getSource().addFeature(box(question.map_from_label, question.length_m, question.width_m, { colour: VERMILION, fill: 0.12, row: question }));
    // Nor does the map move under a drawing.
    if (stays || this.drawing) return;
    const view = this.map.getView();
    const across_m = question.image ? AROUND_M : Math.max(question.length_m, question.width_m);
    const resolution = Math.min(view.getResolution(), across_m / 120);
    // The panel covers the left, and images the lower third.
    const [wide, high] = this.map.getSize();
    const [x, y] = middle(question);
    const center = wide > 760 ? [x - 0.1 * wide * resolution, y - 0.17 * high * resolution] : [x, y];
    view.animate({ center, resolution, duration: 200 });
    clearTimeout(this.looking);
    // Who is seen in an image is shown in that one.
    if (question.image) return;
    this.looking = setTimeout(() => { if (!this.drawing) this.page.images(middle(question)); }, 300);
  }

  /** What is said where nothing is asked. */
  nothing() {
    const { kind, ranked: { unplaced = 0 } = {} } = this;
    if (kind === "person") return unplaced ? `${unplaced} cannot be asked about: the map does not say where their images were taken.` : "nobody is worth asking about; the plan people asks, anew with each run. Who was missed is drawn on whole images.";
    if (this.labels.some((label) => label.kind === kind && label.standing !== "rejected")) return "nothing is worth asking";
    return `Draw a ${kind.replaceAll("_", " ")}, or a few: others will be found.`;
  }

  /** Shows the part of an image that a question is about, or why it is not there. */
  async lookAt(question) {
    const wanted = question && shown(question);
    $("seen").hidden = !wanted;
    if (!wanted || wanted === this.seen) return;
    this.seen = wanted;
    const { image, rectangle } = question;
    $("seen-image").hidden = true;
    $("seen-note").textContent = "reading the image …";
    const found = await part(image, rectangle).catch((error) => error);
    if (this.seen !== wanted) return;
    const isThere = found instanceof Blob;
    URL.revokeObjectURL($("seen-image").src);
    $("seen-image").hidden = !isThere;
    if (isThere) $("seen-image").src = URL.createObjectURL(found);
    $("seen-note").textContent = `${image.session}, ${image.camera}${isThere ? "" : `: the image cannot be shown: ${found.message}`}`;
  }

  /** Leaves a question open: of people it does not come again, as what others say does not change the list. */
  skip() {
    if (this.question?.image) this.skipped.add(shown(this.question));
    this.next();
  }

  /** Goes on to the next question. */
  next() {
    this.asked = this.asked.filter((one) => one !== this.question);
    this.ask(this.asked[0]);
  }

  async answer(standing) {
    const { question } = this;
    if (!question) return;
    const [ring] = box(question.map_from_label, question.length_m, question.width_m, { colour: BLUE }).getGeometry().getCoordinates();
    this.next();
    await this.say([{ type: "Feature", geometry: { type: "Polygon", coordinates: [ring] }, properties: { kind: this.kind, standing, image: question.image } }]);
  }

  /** Says features; they are saved when this returns `true`. */
  async say(features, isUndo = false) {
    this.saving = true;
    $("saved").textContent = "saving …";
    try {
      const answer = await teaching([this.state.site], {}, { author: this.author(), features: { type: "FeatureCollection", features } });
      if (!isUndo) this.saved(answer);
      $("saved").textContent = [answer.saved ? `saved; labels: ${answer.labels.length}` : "was so already", ...answer.notes].join("; ");
      this.show(answer);
      this.rank();
      return true;
    } catch (error) {
      $("saved").textContent = "NOT saved";
      this.page.fault(`not saved: ${error.message}`);
      return false;
    } finally {
      this.saving = false;
    }
  }

  /** Knows how what was saved is taken back. */
  saved({ saved, undo }) {
    if (saved > 0) this.undone.push(undo.features);
    $("undo").disabled = this.undone.length === 0;
  }

  /** Takes the last act back; it is when this returns `true`. */
  async undo() {
    const features = this.undone.pop();
    if (!features) return false;
    const isDone = await this.say(features, true);
    if (!isDone) this.undone.push(features);
    $("undo").disabled = this.undone.length === 0;
    return isDone;
  }

  /** The label that a person points at. */
  choose(label) {
    this.chosen = label;
    $("chosen").hidden = !label;
    $("chosen-name").textContent = label ? `${label.kind.replaceAll("_", " ")}, ${label.standing} by ${label.author}` : "";
  }

  remove() {
    if (!this.chosen) return undefined;
    const { label, kind } = this.chosen;
    return this.say([{ type: "Feature", id: label, geometry: null, properties: { kind, standing: "removed" } }]);
  }

  /** What a click at a pixel is for: true where the page has nothing else to do. */
  clicked(pixel) {
    if (this.drawing) return true;
    const label = this.map.forEachFeatureAtPixel(pixel, (found) => found.get("label"), { layerFilter: (made) => made === this.said });
    this.choose(label);
    return Boolean(label);
  }

  /** Stops drawing. */
  stop() {
    if (this.drawing) this.map.removeInteraction(this.drawing);
    this.drawing = undefined;
    for (const id of ["draw-box", "draw-area", "draw-line"]) $(id).classList.remove("on");
  }

  draw(shape) {
    this.stop();
    clearTimeout(this.looking);
    this.page.clear();
    $(`draw-${shape}`).classList.add("on");
    const style = new ol.style.Style({
      stroke: new ol.style.Stroke({ color: VERMILION, width: 2 }), fill: new ol.style.Fill({ color: faint(VERMILION, 0.15) }),
      image: new ol.style.Circle({ radius: 5, stroke: new ol.style.Stroke({ color: VERMILION, width: 2 }) }),
    });
    const how = { box: { type: "LineString", maxPoints: 3, geometryFunction: byThree }, area: { type: "Polygon" }, line: { type: "LineString" } };
    const drawing = new ol.interaction.Draw({ ...how[shape], style, stopClick: true });
    drawing.on("drawend", ({ feature }) => {
      const kind = shape === "line" ? "LineString" : "Polygon";
      this.say([{ type: "Feature", geometry: { type: kind, coordinates: feature.getGeometry().getCoordinates() }, properties: { kind: this.kind, standing: "drawn" } }]);
      // The click that ends it is not one on the map.
      setTimeout(() => this.stop(), 300);
    });
    this.map.addInteraction(drawing);
    this.drawing = drawing;
  }
}

/** A box by three corners: one side, and how far the other lies from it. */
function byThree(points, geometry) {
  const [a, b, c = b] = points;
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const squared = dx * dx + dy * dy || 1;
  const across = ((c[0] - b[0]) * -dy + (c[1] - b[1]) * dx) / squared;
  const [x, y] = [-dy * across, dx * across];
  const ring = [a, b, [b[0] + x, b[1] + y], [a[0] + x, a[1] + y], a];
  if (!geometry) return new ol.geom.Polygon([ring]);
  geometry.setCoordinates([ring]);
  return geometry;
}
