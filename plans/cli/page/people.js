/** People on whole images: a box is drawn around who was missed. What the page calls saved is on the disk. */
import { GREEN, GREY, SKY, VERMILION, YELLOW, faint } from "./colours.js";
import { listed, same, Viewer } from "./pictures.js";
import { literal, sql, teaching } from "./server.js";

/* global ol */

const $ = (id) => document.getElementById(id);
/** From the centre of the first pixel at (0, 0), as rectangles of layers have it, to the image's corner. */
const CORNER_PX = 0.5;
/** A box whose sides are shorter is a hand that shook, px. */
const LEAST_PX = 2;

/** What a click on an image does. */
const TOOLS = ["draw", "remove"];
const HOW = {
  found: { colour: SKY, dashed: true }, asked: { colour: YELLOW, dashed: true },
  drawn: { colour: GREEN }, accepted: { colour: GREEN }, rejected: { colour: GREY, dashed: true },
};

/** The images that people are looked for in, by the instants that questions name: those of keyframes, else pictures. */
const images = (site, there) => listed(there.get("keyframes")?.rows
  ? `SELECT session, i['camera'] AS camera, stamp FROM (SELECT session, stamp, unnest(images) AS i FROM keyframes WHERE site = ${literal(site)})`
  : `SELECT session, camera, stamp FROM pictures WHERE site = ${literal(site)}`);

/** The images that people are asked about in, in the order of the questions. */
const asked = (site) => `SELECT session, camera, CAST(CAST(stamp AS BIGINT) AS TEXT) AS stamp
  FROM person_questions WHERE site = ${literal(site)} ORDER BY question`;

const found = (site, { session, camera, stamp }) => `SELECT rectangle FROM people
  WHERE site = ${literal(site)} AND session = ${literal(session)} AND camera = ${literal(camera)} AND CAST(stamp AS BIGINT) = ${stamp}`;

/** How many answers the map has not learnt from, in words. */
export const waiting = (count) => (count ? `${count === 1 ? "1 answer about a person waits" : `${count} answers about people wait`} for the next run of the plan people` : "");

const cornered = ({ rectangle }) => rectangle.map((at) => at + CORNER_PX);

export class Missed extends Viewer {
  /**
   * @param {{site?: string, version?: number, there: Map<string, object>}} state what is shown
   * @param {import("./teach.js").Teaching} taught
   * @param {{fault: (text: string) => void}} page
   */
  constructor(state, taught, page) {
    super("people", TOOLS, state, page);
    Object.assign(this, { taught, asked: [], said: [], found: [] });
    for (const [id, doing] of Object.entries({
      "people-draw": () => this.draw(), "people-remove": () => this.removing(), "people-undo": () => this.undo(), "people-asked": () => this.nextAsked(),
    })) $(id).addEventListener("click", doing);
    Object.assign(this.keys, {
      b: () => this.draw(), x: () => this.removing(), Delete: () => this.removing(), u: () => this.undo(), n: () => this.nextAsked(),
    });
    taught.heard = () => this.look();
  }

  /** Opens an image; where none is named, the first that people are asked about in. @param {{session: string, camera: string, stamp: string}} [wanted] */
  async open(wanted) {
    const { site, version, there } = this.state;
    try {
      const [all, first] = await Promise.all([sql(images(site, there), version), there.get("person_questions")?.rows ? sql(asked(site), version) : []]);
      this.asked = first.filter((one, at) => first.findIndex((other) => same(one, other)) === at);
      return await this.begin(all, wanted ?? this.asked[0]);
    } catch (error) {
      return this.page.fault(error.message);
    }
  }

  /** Shows the next image that people are asked about in; behind the last one the first. */
  nextAsked() {
    const here = this.asked.findIndex((one) => same(one, this.at));
    const next = this.asked[(here + 1) % this.asked.length];
    const known = next && this.images.find((one) => same(one, next));
    if (known) this.show(known);
  }

  /** Shows an image with whom the map found, whom it asks about, and what was said. */
  async show(one) {
    Object.assign(this, { said: [], found: [] });
    const picture = this.turn(one);
    $("people-asked").disabled = this.asked.length === 0;
    try {
      const { site, version, there } = this.state;
      const [people, said] = await Promise.all([there.get("people")?.rows ? sql(found(site, one), version) : [], this.ask(), picture.decode()]);
      if (this.at !== one) return;
      this.boxes = new ol.layer.Vector({ source: new ol.source.Vector({ wrapX: false }) });
      this.lay(picture, () => [this.boxes]);
      this.found = people.map(cornered);
      this.isReady = true;
      this.lie(said);
      this.draw();
    } catch (error) {
      if (this.at === one) this.unseen(error);
    }
  }

  /** What was said of the image. */
  ask() {
    return teaching([this.state.site, "person", "boxes"], this.at);
  }

  /** Looks what is said now, here or by others. */
  async look() {
    const { at } = this;
    if (!this.isOpen || !this.isReady || this.saving) return;
    const said = await this.ask().catch(() => undefined);
    if (said && this.at === at && this.isReady && !this.isDrawing && !this.saving) this.lie(said);
  }

  /** Shows what was said, over whom the map asks about, over whom it found. */
  lie({ labels, waiting: count }) {
    this.said = labels;
    const open = this.taught.openIn(this.at).map((one) => ({ how: "asked", box: cornered(one) }));
    const said = labels.filter(({ box }) => box).map((row) => ({ how: row.standing, box: row.box, row }));
    const features = [...this.found.map((box) => ({ how: "found", box })), ...open, ...said].map((one) => this.outlined(one));
    this.boxes.getSource().clear();
    this.boxes.getSource().addFeatures(features);
    const unseen = labels.length - said.length;
    $("people-note").textContent = `said of this image: ${labels.length}${unseen ? `, ${unseen} of them of nobody whom it shows` : ""}`;
    $("people-waiting").textContent = waiting(count);
    $("people-undo").disabled = this.taught.undone.length === 0;
  }

  outlined({ how, box: [left, top, right, bottom], row }) {
    const { colour, dashed } = HOW[how] ?? HOW.rejected;
    const corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]].map((at) => this.turned(at));
    const made = new ol.Feature(new ol.geom.Polygon([corners]));
    made.setStyle(new ol.style.Style({
      stroke: new ol.style.Stroke({ color: colour, width: row ? 3 : 2, lineDash: dashed ? [6, 5] : undefined }),
      fill: new ol.style.Fill({ color: faint(colour, 0.05) }),
    }));
    made.set("row", row);
    return made;
  }

  /** The next boxes that are dragged from corner to corner are people. */
  draw() {
    this.stop();
    if (!this.isReady) return;
    const style = new ol.style.Style({
      stroke: new ol.style.Stroke({ color: VERMILION, width: 2 }), fill: new ol.style.Fill({ color: faint(VERMILION, 0.15) }),
      image: new ol.style.Circle({ radius: 4, stroke: new ol.style.Stroke({ color: VERMILION, width: 2 }) }),
    });
    const drawing = new ol.interaction.Draw({ type: "Circle", geometryFunction: ol.interaction.Draw.createBox(), freehand: true, style, stopClick: true });
    this.draws("draw", drawing, (geometry) => this.drawn(geometry.getExtent()));
  }

  /** The next clicks take back what was said of who is pointed at, whoever said it. */
  removing() {
    this.stop();
    if (this.isReady) this.clicks("remove", (_, pixel) => this.remove(this.rowAt(pixel, this.boxes)));
  }

  /** Says that somebody is in a box; what lies beyond the image's edge ends there. */
  drawn([left, bottom, right, top]) {
    const box = [...this.within([left, top]), ...this.within([right, bottom])];
    const isDrawn = box[2] - box[0] >= LEAST_PX && box[3] - box[1] >= LEAST_PX;
    if (!isDrawn) return this.page.fault("drag from one corner of the box to the other, on the image");
    return this.does(async () => {
      const answer = await teaching([this.state.site, "person", "boxes"], this.at, { author: this.taught.author(), boxes: [box] });
      this.taught.saved(answer);
      return answer.saved > 0 ? "saved" : "was so already";
    });
  }

  remove(row) {
    if (!row) return undefined;
    const properties = { kind: "person", standing: "removed" };
    return this.does(async () => (await this.taught.say([{ type: "Feature", id: row.label, geometry: null, properties }])) && "removed");
  }

  undo() {
    if (this.taught.undone.length === 0) return undefined;
    return this.does(async () => (await this.taught.undo()) && "taken back");
  }

  /** Does something that is said on the disk, and shows what there is then. `doing` answers what it was, or what is false. */
  async does(doing) {
    const { at } = this;
    this.page.fault("");
    this.saving = true;
    $("people-saved").textContent = "saving …";
    try {
      const done = await doing();
      if (this.at === at) $("people-saved").textContent = done || "NOT saved";
    } catch (error) {
      if (this.at === at) $("people-saved").textContent = "NOT saved";
      this.page.fault(`not saved: ${error.message}`);
    } finally {
      this.saving = false;
    }
    // What is open now is asked anew, which shows this image as it is then.
    await this.taught.look();
    await this.look();
  }
}
