/** The drawer: rows of queries, a row with its layer, camera images of a place. Text of maps is text, never markup. */
import { image } from "./server.js";

const $ = (id) => document.getElementById(id);
const MOST = 500;

function text(value) {
  if (value === null || value === undefined) return "";
  const short = (_, found) => (typeof found === "number" && !Number.isInteger(found) ? Number(found.toPrecision(7)) : found);
  const said = typeof value === "string" ? value : JSON.stringify(value, short);
  return said.length > 300 ? `${said.slice(0, 300)} … (${said.length} letters)` : said;
}

function cell(kind, value) {
  const made = document.createElement(kind);
  made.textContent = text(value);
  return made;
}

function show(title, body, images = []) {
  $("drawer-title").textContent = title;
  $("rows").replaceChildren(body);
  $("images").replaceChildren(...images);
  $("drawer").hidden = false;
}

/** Rows of a query. @param {(row: object) => void} chosen */
export function rows(title, found, chosen) {
  if (found.length === 0) {
    const none = document.createElement("p");
    none.textContent = "no rows";
    return show(title, none);
  }
  const table = document.createElement("table");
  const names = Object.keys(found[0]);
  table.createTHead().insertRow().append(...names.map((name) => cell("th", name)));
  const body = table.createTBody();
  for (const row of found.slice(0, MOST)) {
    const line = body.insertRow();
    line.append(...names.map((name) => cell("td", row[name])));
    line.tabIndex = 0;
    line.addEventListener("click", () => chosen?.(row));
    line.addEventListener("keydown", ({ key }) => { if (key === "Enter") chosen?.(row); });
  }
  const more = found.length > MOST ? `, the first ${MOST} are listed` : "";
  show(`${title}: ${found.length} rows${more}`, table);
}

/**
 * One row, a column a line, with what is known of its layer.
 * @param {Map<string, {unit: string, meaning: string}>} [columns] what the map's dictionary says of its columns
 * @param {HTMLElement} [more] what stands below
 */
export function one(title, row, layer, columns = new Map(), more = undefined) {
  const table = document.createElement("table");
  const all = { ...row, ...(layer ? { "layer's operator": layer.operator ?? "a query", "layer's digest": layer.digest } : {}) };
  for (const [name, value] of Object.entries(all)) {
    const { unit, meaning } = columns.get(name) ?? {};
    const line = table.insertRow();
    line.append(cell("th", name), cell("td", value), cell("td", unit), cell("td", meaning));
    line.lastChild.className = "quiet";
  }
  const body = document.createElement("div");
  body.append(table, ...(more ? [more] : []));
  show(title, body);
}

/**
 * Camera images of a place: rows with session, camera, stamp (ns, text) and range_m.
 * @param {(row: object) => void} [label] labels the pixels of an image, where people may
 */
export function images(title, found, version, label) {
  const note = document.createElement("p");
  note.className = "quiet";
  note.textContent = found.length ? "of each session and camera the nearest image whose camera faces the place" : "no keyframe's camera faces this place";
  const figures = found.map((row) => {
    const [figure, picture, caption] = ["figure", "img", "figcaption"].map((kind) => document.createElement(kind));
    picture.alt = `${row.camera} of ${row.session}`;
    picture.loading = "lazy";
    picture.src = image(row.session, row.camera, row.stamp, version);
    picture.addEventListener("error", () => { caption.textContent += " (its log is not there)"; });
    caption.textContent = `${row.session}, ${row.camera}, ${row.range_m.toFixed(1)} m`;
    figure.append(picture, caption);
    if (label) {
      const button = document.createElement("button");
      button.textContent = "label";
      button.title = "say what its pixels are";
      button.addEventListener("click", () => label(row));
      caption.append(" ", button);
    }
    return figure;
  });
  show(title, note, figures);
}

/** Closes the drawer. */
export function close() {
  $("drawer").hidden = true;
}
