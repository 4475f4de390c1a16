/** Features of OpenLayers from the numbers of rows. Each carries its `row`. */
import { faint } from "./colours.js";

/* global ol */

function feature(geometry, style, row) {
  const made = new ol.Feature(geometry);
  made.setStyle(style);
  made.set("row", row);
  return made;
}

const stroke = ({ colour, width = 2, dashed }) =>
  new ol.style.Stroke({ color: colour, width, lineDash: dashed ? [6, 5] : undefined });

/** A line through points, `[x, y, …]` each, m. */
export function line(points, options) {
  const style = new ol.style.Style({ stroke: stroke(options) });
  return feature(new ol.geom.LineString(points.map(([x, y]) => [x, y])), style, options.row);
}

/** A dot at `[x, y]`, m. */
export function point(at, { row, colour, radius = 4 }) {
  const circle = new ol.style.Circle({
    radius, fill: new ol.style.Fill({ color: colour }), stroke: new ol.style.Stroke({ color: "#fffc", width: 1 }),
  });
  return feature(new ol.geom.Point(at), new ol.style.Style({ image: circle }), row);
}

/** Arrow heads half-way along a line, one for each direction that may be driven. */
export function arrow(points, direction, { row, colour }) {
  if (points.length < 2 || !["forward", "backward", "both"].includes(direction)) return [];
  const middle = Math.max(1, Math.floor(points.length / 2));
  const [[ax, ay], [bx, by]] = [points[middle - 1], points[middle]];
  const yaw = Math.atan2(by - ay, bx - ax);
  const head = (turn) => {
    const shape = new ol.style.RegularShape({
      points: 3, radius: 8, rotation: Math.PI / 2 - yaw + turn, rotateWithView: true,
      fill: new ol.style.Fill({ color: colour }), stroke: new ol.style.Stroke({ color: "#0006", width: 1 }),
    });
    return feature(new ol.geom.Point([(ax + bx) / 2, (ay + by) / 2]), new ol.style.Style({ image: shape }), row);
  };
  const turns = { forward: [0], backward: [Math.PI], both: [0, Math.PI] }[direction];
  return turns.map(head);
}

/** Heading of a pose, rad: its x axis from above. */
export function yaw({ qx, qy, qz, qw }) {
  return Math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz));
}

/** A box about a pose, m. */
export function box(pose, length_m, width_m, options) {
  const [cos, sin] = [Math.cos(yaw(pose)), Math.sin(yaw(pose))];
  const corner = (along, across) => {
    const [dx, dy] = [(along * length_m) / 2, (across * width_m) / 2];
    return [pose.x + cos * dx - sin * dy, pose.y + sin * dx + cos * dy];
  };
  const ring = [corner(1, 1), corner(-1, 1), corner(-1, -1), corner(1, -1), corner(1, 1)];
  const style = new ol.style.Style({
    stroke: stroke(options), fill: new ol.style.Fill({ color: faint(options.colour, options.fill ?? 0.05) }),
  });
  return feature(new ol.geom.Polygon([ring]), style, options.row);
}

const finite = (value) => typeof value === "number" && Number.isFinite(value);

/** `[x, y]` of a list or a struct, m; `null` where it is neither. */
function position(value) {
  if (Array.isArray(value)) return value.length > 1 && finite(value[0]) && finite(value[1]) ? [value[0], value[1]] : null;
  return value && finite(value.x) && finite(value.y) ? [value.x, value.y] : null;
}

/** Well-known binary as hexadecimal, little-endian: points to collections, from above or with z. */
const WKB = /^01(0[1-7]00|e[9a-f]03)0000/i;
const WKT = /^\s*(MULTI)?(POINT|LINESTRING|POLYGON)/i;

/** The geometry that a value writes down; `null` where it only begins like one. */
function written(value) {
  const format = WKT.test(value) ? new ol.format.WKT() : WKB.test(value) ? new ol.format.WKB({ hex: true }) : null;
  try {
    return format?.readGeometry(value) ?? null;
  } catch {
    return null;
  }
}

/**
 * Where a row of any query is: `{at, yaw?}` of columns `x` and `y`, `x_m` and `y_m`, a point or a pose; `{geometry}` of
 * a list of points, well-known text or binary; `null` where it has none.
 */
export function placed(row) {
  for (const [x, y] of [["x", "y"], ["x_m", "y_m"]]) {
    if (finite(row[x]) && finite(row[y])) return { at: [row[x], row[y]] };
  }
  for (const value of Object.values(row)) {
    if (typeof value === "string") {
      const geometry = written(value);
      if (geometry) return { geometry };
    } else if (Array.isArray(value) && value.length > 1) {
      const points = value.map(position);
      if (points.every(Boolean)) return { geometry: new ol.geom.LineString(points) };
    } else if (position(value) && !Array.isArray(value)) {
      return { at: position(value), yaw: finite(value.qw) ? yaw(value) : undefined };
    }
  }
  return null;
}

/** A feature of a row of any query, from where it is: a dot, an arrow for a pose, a line or an area. */
export function anything({ at, yaw: heading, geometry }, { row, colour }) {
  if (geometry) {
    const dot = new ol.style.Circle({ radius: 6, fill: new ol.style.Fill({ color: colour }) });
    return feature(geometry, new ol.style.Style({ image: dot, stroke: stroke({ colour, width: 4 }), fill: new ol.style.Fill({ color: faint(colour, 0.2) }) }), row);
  }
  if (heading === undefined) return point(at, { row, colour, radius: 6 });
  const head = new ol.style.RegularShape({
    points: 3, radius: 9, scale: [0.7, 1], rotation: Math.PI / 2 - heading, rotateWithView: true,
    fill: new ol.style.Fill({ color: colour }), stroke: new ol.style.Stroke({ color: "#fffc", width: 1 }),
  });
  return feature(new ol.geom.Point(at), new ol.style.Style({ image: head }), row);
}

/** An outline: a line, or closed. `[x, y, …]` of each point, m. */
export function outline(points, closed, options) {
  if (!closed) return line(points, options);
  const ring = [...points, points[0]].map(([x, y]) => [x, y]);
  const style = new ol.style.Style({ stroke: stroke(options), fill: new ol.style.Fill({ color: faint(options.colour, 0.05) }) });
  return feature(new ol.geom.Polygon([ring]), style, options.row);
}
