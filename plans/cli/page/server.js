/** What the page asks the server. All addresses are relative to the page's own. */

/** Others teach too: what they said is asked for this often, ms. */
export const OTHERS_MS = 4000;

/** An error as the server says it. */
export class Fault extends Error {
  constructor({ error, next }) {
    super(next ? `${error}; ${next}` : error);
  }
}

/**
 * The rows of a query.
 * @param {string} query
 * @param {number|undefined} version the newest where none is named
 * @param {AbortSignal} [signal]
 * @returns {Promise<object[]>}
 */
export async function sql(query, version, signal) {
  const address = version === undefined ? "./sql" : `./sql?version=${version}`;
  const answer = await fetch(address, { method: "POST", body: query, signal });
  if (answer.ok) return exact(await answer.text());
  const said = await answer.json().catch(() => ({ error: `the server answers ${answer.status}` }));
  throw new Fault(said);
}

/** What a JSON text says; integers that a number of JavaScript cannot hold become text, digit by digit. */
function exact(text) {
  if (!/[[:,]\s*-?\d{16,}\s*[,\]}]/.test(text)) return JSON.parse(text);
  return JSON.parse(text, (_, value, from) =>
    (typeof value === "number" && Number.isInteger(value) && !Number.isSafeInteger(value) ? from?.source ?? value : value));
}

/**
 * A name as a part of a path. Browsers take `.` and `..` for folders, however they are encoded: a `~` stands before these, and
 * before `~.`, which would be read as `.`.
 */
function segment(name) {
  return encodeURIComponent(/^~*\.\.?$/.test(name) ? `~${name}` : name);
}

/**
 * Asks a server that is taught: of nothing who may teach, of `[site]` its labels, or those
 * of an image that is asked for, of `[site, kind]` what may be of a kind.
 * @param {string[]} [of] any texts: a name may have a slash, or be `..`
 * @param {object} [asked]
 * @param {object} [said] what is said of the site, or of the image
 */
export async function teaching(of = [], asked = {}, said = undefined) {
  const address = `${["./teach", ...of.map(segment)].join("/")}?${new URLSearchParams(asked)}`;
  const how = said && { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(said) };
  const answer = await fetch(address, how);
  if (answer.ok) return answer.json();
  throw new Fault(await answer.json().catch(() => ({ error: `the server answers ${answer.status}` })));
}

/** The maps that are served: `[{name, path}]`. */
export async function maps() {
  const answer = await fetch("/maps");
  return answer.ok ? answer.json() : [];
}

/** The address of a tile, by the numbers of its row. */
export function tile(site, version, zoom, x, y) {
  return `./tiles/${segment(site)}/${version}/${zoom}/${x}/${y}`;
}

/** The address of a camera image that a keyframe names. */
export function image(session, camera, stamp, version) {
  return `./images?${new URLSearchParams({ session, camera, stamp, version })}`;
}

/**
 * The part of a camera image around a rectangle, which is drawn.
 * @param {{session: string, camera: string, stamp: string}} image
 * @param {number[]} around least column and row, largest column and row
 * @returns {Promise<Blob>}
 */
export async function part({ session, camera, stamp }, around) {
  const answer = await fetch(`./images?${new URLSearchParams({ session, camera, stamp, around: around.join(",") })}`);
  if (answer.ok) return answer.blob();
  throw new Fault(await answer.json().catch(() => ({ error: `the server answers ${answer.status}` })));
}

/** A text as a literal of SQL. */
export function literal(text) {
  return `'${String(text).replaceAll("'", "''")}'`;
}
