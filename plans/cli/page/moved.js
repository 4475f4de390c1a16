/** What moved since the version before. */
import { VERMILION, faint } from "./colours.js";
import { literal, sql } from "./server.js";

/* global ol */

const COMPARED = ["poses", "lanes", "intersections", "parking_spaces"];

/**
 * What changed from one version to the next, of each layer that is compared: `[{layer, text}]`.
 * @param {{site: string, version: number, before: number, there: Map<string, {rows: number}>}} of
 * @param {AbortSignal} signal
 */
export async function changes({ site, version, before, there }, signal) {
  const layers = COMPARED.filter((layer) => there.get(layer)?.rows);
  if (layers.length === 0) return [];
  const query = layers.map((layer) => `SELECT '${layer}' AS layer, change, count(*) AS n, max(moved_m) AS most_m
    FROM diff('${layer}', ${before}, ${version}) WHERE site = ${literal(site)} GROUP BY change`).join(" UNION ALL ");
  const rows = await sql(`${query} ORDER BY layer, change`, version, signal);
  const said = ({ change, n, most_m }) => `${n} ${change}${most_m ? ` by up to ${most_m.toFixed(2)} m` : ""}`;
  return layers.flatMap((layer) => {
    const parts = rows.filter((row) => row.layer === layer && row.change !== "same").map(said);
    return parts.length ? [{ layer, text: parts.join(", ") }] : [];
  });
}

/** Halos of the lanes that moved by more than 0.1 m, as features. */
export async function lanes({ site, version, before }, signal) {
  const rows = await sql(`SELECT l.lane, d.moved_m, l.points FROM diff('lanes', ${before}, ${version}) d
    JOIN lanes l ON l.site = d.site AND l.lane = d.lane WHERE d.site = ${literal(site)} AND d.moved_m > 0.1`, version, signal);
  const halo = new ol.style.Style({ stroke: new ol.style.Stroke({ color: faint(VERMILION, 0.25), width: 12 }) });
  return rows.map(({ points }) => {
    const made = new ol.Feature(new ol.geom.LineString(points.map(([x, y]) => [x, y])));
    made.setStyle(halo);
    return made;
  });
}
