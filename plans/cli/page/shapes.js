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

/**
 * What is drawn of a row of any query: points in columns `x` and `y` or `x_m` and `y_m`, structs with `x` and `y` (with
 * an orientation: an arrow), lists of points, well-known text. `null` where there is none.
 */
export function anything(row, colour) {
  const number = (value) => typeof value === "number" && Number.isFinite(value);
  for (const [x, y] of [["x", "y"], ["x_m", "y_m"]]) {
    if (number(row[x]) && number(row[y])) return point([row[x], row[y]], { row, colour, radius: 6 });
  }
  for (const value of Object.values(row)) {
    if (value && number(value.x) && number(value.y)) return point([value.x, value.y], { row, colour, radius: 6 });
    const isLine = Array.isArray(value) && value.length > 1 && value.every((at) => Array.isArray(at) && number(at[0]) && number(at[1]));
    if (isLine) return line(value, { row, colour, width: 4 });
    if (typeof value === "string" && /^\s*(MULTI)?(POINT|LINESTRING|POLYGON)/i.test(value)) {
      try {
        const geometry = new ol.format.WKT().readGeometry(value);
        const style = new ol.style.Style({ stroke: stroke({ colour, width: 4 }), fill: new ol.style.Fill({ color: faint(colour, 0.2) }) });
        return feature(geometry, style, row);
      } catch {
        // A text that only begins like a geometry.
      }
    }
  }
  return null;
}
