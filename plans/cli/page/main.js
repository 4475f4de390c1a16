/** The page of a map: what is chosen, and what follows from it. */
import * as address from "./address.js";
import { VERMILION } from "./colours.js";
import { SHOWN } from "./layers.js";
import * as earth from "./earth.js";
import { lineage } from "./lineage.js";
import * as drawn from "./map.js";
import * as comparison from "./moved.js";
import { Painting } from "./paint.js";
import { Missed } from "./people.js";
import { can as hasImages } from "./pictures.js";
import * as drawer from "./rows.js";
import { literal, maps, sql } from "./server.js";
import { anything, placed } from "./shapes.js";
import * as teach from "./teach.js";

/* global ol */

const $ = (id) => document.getElementById(id);
const state = { versions: [], version: undefined, site: undefined, origin: undefined, on: new Set(), there: new Map(), query: "" };
/** What is asked of the server for the site and version that are shown; another choice ends it. */
let asking = new AbortController();
/** More points of a query than these are drawn as marks. */
const MANY = 2000;
const map = drawn.create("map");
/** What is drawn: the layers of OpenLayers by id, in the order of `SHOWN`. */
const shown = new Map();
/** What is drawn of the query's answer. */
let results = drawn.layer({ features: [] }, state, 100);
const moved = new ol.layer.Vector({ source: new ol.source.Vector(), zIndex: 90 });
map.addLayer(moved);
map.addLayer(results);
window.evermap = { map, state };

/** What is taught, where the server lets people teach, what is painted on images, and who is drawn on them. */
let taught;
let painting;
let missed;

let working = 0;
async function work(what, doing) {
  working += 1;
  $("busy").textContent = what;
  try {
    return await doing();
  } catch (error) {
    if (error.name !== "AbortError") fault(error.message);
    return undefined;
  } finally {
    working -= 1;
    if (working === 0) $("busy").textContent = "";
  }
}

function fault(text) {
  $("fault").textContent = text;
  $("fault").hidden = !text;
}

function said(step) {
  const [x, y] = map.getView().getCenter().map((value) => Number(value.toFixed(2)));
  address.write({
    site: state.site, version: state.version === state.versions.at(-1)?.version ? undefined : state.version,
    x, y, m_per_px: Number(map.getView().getResolution().toPrecision(4)), on: [...state.on], query: state.query,
  }, step);
}

/** Reads what there is, and shows what the address says. */
async function begin() {
  const asked = address.read();
  $("theme").addEventListener("click", theme);
  document.documentElement.dataset.theme = localStorage.getItem("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  const [versions, served] = await Promise.all([
    work("versions", () => sql("SELECT version, published, plan, sessions FROM versions ORDER BY version")), maps().catch(() => []),
  ]);
  if (!versions) return;
  state.versions = versions;
  others(served);
  const known = versions.some(({ version }) => version === asked.version);
  state.version = known ? asked.version : versions.at(-1)?.version;
  folded(innerWidth <= 760);
  $("version").max = versions.length - 1;
  $("version").value = versions.findIndex(({ version }) => version === state.version);
  state.on = new Set(asked.on ?? SHOWN.filter((one) => one.on).map((one) => one.id));
  await opened(asked.site);
  if (asked.m_per_px) {
    map.getView().setCenter([asked.x ?? 0, asked.y ?? 0]);
    map.getView().setResolution(asked.m_per_px);
  } else fit();
  map.on("moveend", () => said(false));
  taught = await teach.begin(map, state, { fault, images: place, clear: drawer.close });
  painting = taught && new Painting(state, { fault, author: () => taught.author() });
  missed = taught && new Missed(state, taught, { fault });
  Object.assign(window.evermap, { taught, painting, missed });
  imaged();
  if (asked.query) {
    $("sql").value = asked.query;
    run(false);
  }
}

/** Offers what people may do on images, where there are some. */
function imaged() {
  const may = Boolean(taught) && hasImages(state.there);
  $("paint-open").hidden = !may;
  $("people-open").hidden = !may || taught.kind !== "person";
}

/** Opens the image of the question whole, or the first one. */
function whole() {
  if (!$("people-open").hidden) missed.open(taught.question?.image);
}

function others(served) {
  $("maps-row").hidden = served.length < 2;
  $("maps").replaceChildren(...served.map(({ name, path }) => new Option(name, path, false, location.pathname === path)));
  $("maps").addEventListener("change", () => { location.href = $("maps").value; });
}

/** Shows the chosen version. */
async function opened(wanted) {
  asking.abort();
  asking = new AbortController();
  const { signal } = asking;
  const { version } = state;
  const layers = await work("layers", () => sql("SELECT layer, rows, operator, digest FROM layers", version, signal));
  if (!layers || signal.aborted) return;
  state.there = new Map(layers.map((row) => [row.layer, row]));
  const from = ["poses", "overhead_tiles", "lanes", "views", "pictures"].filter((layer) => state.there.get(layer)?.rows);
  const union = from.map((layer) => `SELECT DISTINCT site FROM ${layer}`).join(" UNION ");
  const sites = union ? await work("sites", () => sql(`SELECT site FROM (${union}) ORDER BY site`, version, signal)) : [];
  if (signal.aborted) return;
  const names = (sites ?? []).map(({ site }) => site);
  state.site = names.includes(wanted) ? wanted : names.includes(state.site) ? state.site : names[0];
  $("sites").replaceChildren(...names.map((name) => new Option(name, name, false, name === state.site)));
  about();
  list();
  imaged();
  state.origin = await work("where it lies", () => earth.origin(state, signal));
  if (signal.aborted) return;
  earth.point($("north"), state.origin);
  for (const made of shown.values()) map.removeLayer(made);
  shown.clear();
  moved.getSource().clear();
  await Promise.all(SHOWN.filter((one) => state.on.has(one.id) && can(one)).map(draw));
  await changes(signal);
}

/** Says and draws what moved since the version before. */
async function changes(signal) {
  $("moved").replaceChildren();
  const before = state.versions[state.versions.findIndex(({ version }) => version === state.version) - 1]?.version;
  if (before === undefined || signal.aborted) return;
  const of = { site: state.site, version: state.version, there: state.there, before };
  const found = await work("what moved", () => comparison.changes(of, signal));
  for (const { layer, text } of found ?? []) {
    const line = $("moved").insertRow();
    line.insertCell().textContent = layer.replaceAll("_", " ");
    line.insertCell().textContent = text;
  }
  if (signal.aborted || !state.there.get("lanes")?.rows) return;
  const halos = await work("lanes that moved", () => comparison.lanes(of, signal));
  if (halos && !signal.aborted) moved.getSource().addFeatures(halos);
}

function about() {
  const place = state.versions.findIndex(({ version }) => version === state.version);
  const { version, published, plan, sessions } = state.versions[place] ?? {};
  $("version-name").textContent = version === undefined ? "none" : `${version} of ${state.versions.at(-1).version}`;
  $("version-about").textContent = version === undefined ? "" : `${published.slice(0, 16).replace("T", " ")} UTC, ${plan}: ${sessions.join(", ")}`;
}

const can = (one) => [...one.needs, ...(one.needsToo ?? [])].every((layer) => state.there.has(layer));

/** The list of what can be shown. */
function list() {
  const items = SHOWN.filter(can).map((one) => {
    const [item, label, box, name, count] = ["li", "label", "input", "span", "span"].map((kind) => document.createElement(kind));
    const { rows } = state.there.get(one.needs[0]);
    Object.assign(box, { type: "checkbox", checked: state.on.has(one.id), id: `show-${one.id}` });
    box.addEventListener("change", () => {
      if (box.checked) state.on.add(one.id);
      else state.on.delete(one.id);
      if (box.checked) draw(one);
      else hide(one.id);
      said(true);
    });
    name.className = "name";
    name.textContent = one.name;
    count.className = "count";
    count.textContent = rows === 0 ? "empty" : one.rowsOfLayer === false ? "" : rows.toLocaleString("en");
    label.append(box, legend(one.key), name, count);
    item.append(label);
    item.id = `layer-${one.id}`;
    return item;
  });
  $("layers").replaceChildren(...items);
}

function legend([kind, colour, dashed]) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("class", "key");
  made.setAttribute("viewBox", "0 0 22 14");
  const shapes = {
    line: `M1 7H21`, dot: `M11 7h.01`, box: `M4 3H18V11H4Z`, fill: `M3 2H19V12H3Z`, ramp: `M1 7H21`,
  };
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", shapes[kind]);
  path.setAttribute("fill", kind === "fill" ? colour : "none");
  path.setAttribute("stroke", colour ?? "#21918c");
  path.setAttribute("stroke-width", { dot: 8, ramp: 10 }[kind] ?? 2);
  if (dashed) path.setAttribute("stroke-dasharray", "5 3");
  path.setAttribute("stroke-linecap", kind === "dot" ? "round" : "butt");
  made.append(path);
  if (kind === "ramp") {
    const bright = path.cloneNode();
    bright.setAttribute("d", "M12 7H21");
    bright.setAttribute("stroke", "#fde725");
    made.append(bright);
  }
  return made;
}

async function draw(one) {
  const { site, version } = state;
  const { signal } = asking;
  const rows = state.there.get(one.needs[0])?.rows ? await work(one.name, () => sql(one.query(site), version, signal)) : [];
  if (!rows || signal.aborted || !state.on.has(one.id)) return;
  hide(one.id);
  const found = one.draw(rows);
  const made = drawn.layer(found, state, SHOWN.indexOf(one));
  made.set("id", one.id);
  shown.set(one.id, made);
  map.addLayer(made);
  if (rows.length > 0) {
    $(`layer-${one.id}`).querySelector(".count").textContent = rows.length.toLocaleString("en");
    note(one.id, found.note);
  }
}

function note(id, said) {
  const item = $(`layer-${id}`);
  if (!item || !said) return;
  const line = document.createElement("p");
  line.className = "quiet note";
  for (const { text, colour, dashed } of Array.isArray(said) ? said : [{ text: said }]) {
    const part = document.createElement("span");
    part.className = "entry";
    if (colour) part.append(legend(["line", colour, dashed]));
    part.append(text);
    line.append(part);
  }
  item.append(line);
}

function hide(id) {
  $(`layer-${id}`)?.querySelector(".note")?.remove();
  const made = shown.get(id);
  if (made) map.removeLayer(made);
  shown.delete(id);
}

function fit() {
  const all = [...shown.values()].map(drawn.covered).filter(Boolean);
  if (all.length === 0) return;
  const extent = all.reduce((a, b) => ol.extent.extend([...a], b));
  const left = document.body.classList.contains("folded") || innerWidth <= 760 ? 30 : 320;
  map.getView().fit(extent, { padding: [30, 60, 100, left] });
}

/** Runs the query in the box; what has a geometry is drawn. */
async function run(step) {
  const query = $("sql").value.trim();
  fault("");
  answered(new Map());
  drawer.close();
  state.query = query;
  said(step);
  if (!query) return;
  const found = await work("query", () => sql(query, state.version));
  if (!found || state.query !== query) return;
  const places = new Map(found.map((row) => [row, placed(row)]).filter(([, place]) => place));
  answered(places);
  drawer.rows(places.size ? `${places.size} drawn` : "answer", found, (row) => {
    const { at, geometry } = places.get(row) ?? {};
    const center = at ?? (geometry && ol.extent.getCenter(geometry.getExtent()));
    if (center) map.getView().animate({ center, duration: 250 });
  });
}

/** Draws where the rows of an answer are. @param {Map<object, object>} places as `placed` gives them, by row */
function answered(places) {
  const all = [...places];
  const areMarks = all.length > MANY && all.every(([, { at }]) => at);
  map.removeLayer(results);
  results = drawn.layer(areMarks
    ? { points: all.map(([row, { at }]) => ({ row, at, colour: VERMILION })) }
    : { features: all.map(([row, place]) => anything(place, { row, colour: VERMILION })) }, state, 100);
  map.addLayer(results);
}

async function choose(event) {
  if (taught?.clicked(event.pixel)) return undefined;
  const hit = drawn.rowAt(map, new Map([...shown, ["", results]]), event.pixel);
  if (hit?.id) return row(hit);
  if (hit) return drawer.one("row of the answer", hit.row);
  return place(event.coordinate);
}

/** A row with all its columns, and its layer. */
async function row({ row, id }) {
  const one = SHOWN.find((shown) => shown.id === id);
  const layer = state.there.get(one.needs[0]);
  const [whole, columns] = await work("row", () => Promise.all([
    one.where ? sql(`SELECT * FROM ${one.needs[0]} WHERE ${one.where(row, state.site)}`, state.version) : [row],
    sql(`SELECT "column", unit, meaning FROM columns WHERE layer = ${literal(one.needs[0])}`, state.version),
  ])) ?? [[row], []];
  const all = { ...row, ...whole[0] };
  const from = lineage(one.needs[0], all, state.version, (query) => { $("sql").value = query; run(true); });
  drawer.one(one.name, all, layer, new Map(columns.map((known) => [known.column, known])), from);
}

/** The camera images that saw a place: of each session and camera the nearest. */
async function place([x, y]) {
  const onEarth = state.origin && await work("where it lies", () => earth.written(state.origin, [x, y], state.version));
  const title = `at ${x.toFixed(2)} m, ${y.toFixed(2)} m${onEarth ? `: ${onEarth}` : ""}`;
  if (!["keyframes", "poses", "mounts"].every((layer) => state.there.has(layer))) return;
  const query = `WITH frames AS (
      SELECT site, session, stamp, unnest(images) AS i FROM keyframes WHERE site = ${literal(state.site)}),
    cameras AS (
      SELECT f.session, f.i['camera'] AS camera, CAST(CAST(f.i['stamp'] AS BIGINT) AS TEXT) AS stamp,
        compose(p.map_from_vehicle, m.parent_from_child) AS pose
      FROM frames f JOIN poses p ON p.site = f.site AND p.session = f.session AND p.stamp = f.stamp
      JOIN (SELECT DISTINCT site, session, child, parent_from_child FROM mounts) m
        ON m.site = f.site AND m.session = f.session AND m.child = f.i['camera']),
    facing AS (
      SELECT session, camera, stamp, pose['x'] AS cx, pose['y'] AS cy,
        transform(pose, 0, 0, 1)['x'] - pose['x'] AS ax, transform(pose, 0, 0, 1)['y'] - pose['y'] AS ay FROM cameras),
    ranged AS (
      SELECT session, camera, stamp, sqrt(power(${x} - cx, 2) + power(${y} - cy, 2)) AS range_m,
        ax * (${x} - cx) + ay * (${y} - cy) AS along FROM facing)
    SELECT session, camera, stamp, range_m FROM (
      SELECT *, row_number() OVER (PARTITION BY session, camera ORDER BY range_m) AS nth FROM ranged
      WHERE range_m > 1 AND range_m < 25 AND along > 0.7 * range_m)
    WHERE nth = 1 ORDER BY range_m LIMIT 12`;
  const found = await work("images", () => sql(query, state.version));
  if (found && !taught?.drawing) drawer.images(title, found, state.version, painting && ((row) => painting.open(row)));
}

function theme() {
  const root = document.documentElement.dataset;
  root.theme = root.theme === "dark" ? "light" : "dark";
  localStorage.setItem("theme", root.theme);
}

function folded(yes) {
  document.body.classList.toggle("folded", yes);
  $("panel").hidden = yes;
  $("unfold").hidden = !yes;
}

let settling;
function toVersion(place) {
  const version = state.versions[Math.min(Math.max(place, 0), state.versions.length - 1)]?.version;
  if (version === undefined || version === state.version) return;
  state.version = version;
  $("version").value = state.versions.findIndex((one) => one.version === version);
  about();
  // A slider passes many versions on its way.
  asking.abort();
  clearTimeout(settling);
  settling = setTimeout(() => { said(true); opened(); }, 120);
}

const KEYS = {
  d: theme, f: fit, w: whole, l: () => folded(!document.body.classList.contains("folded")), "/": () => $("sql").focus(),
  "[": () => toVersion(Number($("version").value) - 1), "]": () => toVersion(Number($("version").value) + 1),
};

$("version").addEventListener("input", () => toVersion(Number($("version").value)));
$("sites").addEventListener("change", async () => { await opened($("sites").value); fit(); said(true); taught?.open(); });
$("fold").addEventListener("click", () => folded(true));
$("unfold").addEventListener("click", () => folded(false));
$("close").addEventListener("click", drawer.close);
$("paint-open").addEventListener("click", () => painting.open());
$("people-open").addEventListener("click", whole);
$("seen-image").addEventListener("click", whole);
$("kind").addEventListener("change", imaged);
$("fault").addEventListener("click", () => fault(""));
$("query").addEventListener("submit", (event) => { event.preventDefault(); run(true); });
$("sql").addEventListener("keydown", (event) => {
  if (event.key === "Enter" && (event.ctrlKey || event.metaKey)) { event.preventDefault(); run(true); }
});
addEventListener("keydown", (event) => {
  const viewer = [painting, missed].find((one) => one?.isOpen);
  if (viewer) { pressed(event, viewer); return; }
  if (event.key === "Escape") { taught?.stop(); drawer.close(); fault(""); $("map").focus(); return; }
  const typing = ["TEXTAREA", "INPUT", "SELECT"].includes(event.target.tagName) && event.target.type !== "checkbox";
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  const doing = KEYS[event.key] ?? taught?.keys[event.key];
  if (!doing) return;
  event.preventDefault();
  doing();
});
/** A key while an image is shown whole; what is typed in a field stays there. */
function pressed(event, viewer) {
  const { tagName, type } = event.target;
  const typing = tagName === "SELECT" || (tagName === "INPUT" && type !== "range");
  if (event.ctrlKey || event.metaKey || event.altKey || (typing && event.key !== "Escape")) return;
  if (typing) event.target.blur();
  else if (viewer.pressed(event.key)) event.preventDefault();
}

addEventListener("popstate", () => location.reload());
map.on("singleclick", choose);
begin();
