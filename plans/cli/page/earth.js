/** Where on earth a site lies, by the map's layer `georeference`. */
import { literal, sql } from "./server.js";

/** The row of a site, or `undefined` where nobody knows. @param {{site: string, version: number, there: Map<string, object>}} of */
export async function origin({ site, version, there }, signal) {
  if (!there.get("georeference")?.rows) return undefined;
  const query = `SELECT latitude_deg, longitude_deg, heading_rad FROM georeference WHERE site = ${literal(site)}`;
  return (await sql(query, version, signal))[0];
}

/** Latitude and longitude of a place of the map (m), as people write them. */
export async function written({ latitude_deg, longitude_deg, heading_rad }, [x, y], version) {
  const query = `SELECT p['latitude_deg'] AS latitude, p['longitude_deg'] AS longitude
    FROM (SELECT geodetic(${latitude_deg}, ${longitude_deg}, 0, ${heading_rad}, ${x}, ${y}, 0) AS p)`;
  const [{ latitude, longitude }] = await sql(query, version);
  const side = (degrees, [positive, negative]) => `${Math.abs(degrees).toFixed(7)}° ${degrees < 0 ? negative : positive}`;
  return `${side(latitude, "NS")}, ${side(longitude, "EW")}`;
}

/** Turns the arrow to where north is: the map has x to the right, and y up. */
export function point(arrow, found) {
  arrow.toggleAttribute("hidden", !found);
  arrow.style.rotate = found ? `${found.heading_rad}rad` : "";
}
