/**
 * What can be shown: of each the layers that it needs, its query, how its rows are drawn, and its legend.
 *
 * `draw` gives `{features}` (OpenLayers features, each with its `row`), or `{points}`/`{cells}`: numbers that are drawn
 * on one canvas, however many there are. `where` says which row of the layer a drawn one is.
 */
import * as colours from "./colours.js";
import { arrow, box, line, outline, point } from "./shapes.js";
import { literal } from "./server.js";

const range = (rows, name) => rows.reduce((most, row) => Math.max(most, row[name] ?? 0), 0);
const key = (...names) => (row, site) =>
  [`site = ${literal(site)}`, ...names.map((name) => `"${name}" = ${typeof row[name] === "number" ? row[name] : literal(row[name])}`)].join(" AND ");

/** Poses of a map by session and keyframe. */
const AT = (site) => `at AS (
  SELECT k.session, k.keyframe, p.map_from_vehicle['x'] AS x, p.map_from_vehicle['y'] AS y
  FROM keyframes k JOIN poses p ON k.site = p.site AND k.session = p.session AND k.stamp = p.stamp
  WHERE k.site = ${literal(site)})`;

export const SHOWN = [
  {
    id: "overhead_tiles", name: "ground from above", needs: ["overhead_tiles"], on: true, key: ["fill", colours.GREY],
    query: (site) => `SELECT zoom, cell_m, size_m, tile_x, tile_y FROM overhead_tiles WHERE site = ${literal(site)}`,
    draw: (rows) => ({ tiles: rows }),
  },
  {
    id: "speed_map", name: "speed, m/s", needs: ["speed_map"], key: ["ramp"],
    query: (site) => `SELECT x, y, cell_m, speed_mps, max_mps, danger FROM speed_map WHERE site = ${literal(site)} AND speed_mps IS NOT NULL`,
    draw: (rows) => {
      const most = range(rows, "speed_mps");
      return { cells: rows.map((row) => ({ row, colour: colours.ramp(row.speed_mps / most, 0.55) })), note: `yellow: up to ${most.toFixed(1)} m/s` };
    },
  },
  {
    id: "danger_map", name: "people on the ground, probability", needs: ["danger_map"], key: ["ramp"],
    query: (site) => `SELECT x, y, cell_m, danger, ground, looks, people FROM danger_map WHERE site = ${literal(site)} AND danger > 0`,
    draw: (rows) => {
      const most = range(rows, "danger");
      return { cells: rows.map((row) => ({ row, colour: colours.ramp(Math.sqrt(row.danger / most), 0.6) })), note: `yellow: up to ${most.toPrecision(2)} in one look` };
    },
  },
  {
    id: "landmarks", name: "landmarks", needs: ["landmarks"], key: ["dot", colours.SKY],
    query: (site) => `SELECT landmark, x, y, z, sigma_m FROM landmarks WHERE site = ${literal(site)}`,
    draw: (rows) => ({ points: rows.map((row) => ({ row, colour: colours.faint(colours.SKY, 0.75) })) }),
    where: key("landmark"),
  },
  {
    id: "poses", name: "trajectories", needs: ["poses"], on: true, key: ["line", colours.BLUE],
    query: (site) => `SELECT session, map_from_vehicle['x'] AS x, map_from_vehicle['y'] AS y FROM poses
      WHERE site = ${literal(site)} ORDER BY session, stamp`,
    draw: (rows) => {
      const sessions = Map.groupBy ? Map.groupBy(rows, (row) => row.session) : grouped(rows);
      const features = [...sessions].map(([session, drive], index) =>
        line(drive.map(({ x, y }) => [x, y]), { row: { session, poses: drive.length }, width: 2, ...colours.ofSession(index) }));
      return { features, note: [...sessions.keys()].map((session, index) => ({ text: session, ...colours.ofSession(index) })) };
    },
  },
  {
    id: "lanes", name: "lanes", needs: ["lanes"], on: true, key: ["line", colours.ORANGE],
    query: (site) => `SELECT lane, direction, length_m, width_m, points FROM lanes WHERE site = ${literal(site)}`,
    draw: (rows) => ({
      features: rows.flatMap((row) => [line(row.points, { row, colour: colours.ORANGE, width: 3 }), ...arrow(row.points, row.direction, { row, colour: colours.ORANGE })]),
    }),
    where: key("lane"),
  },
  {
    id: "intersections", name: "intersections", needs: ["intersections"], on: true, key: ["dot", colours.VERMILION],
    query: (site) => `SELECT node, degree, x, y FROM intersections WHERE site = ${literal(site)}`,
    draw: (rows) => ({ features: rows.map((row) => point([row.x, row.y], { row, colour: colours.VERMILION, radius: 5 })) }),
    where: key("node"),
  },
  {
    id: "loop_closures", name: "loop closures by residual", rowsOfLayer: false, needs: ["graph_poses", "keyframes", "poses"], key: ["ramp"],
    query: (site) => `WITH ${AT(site)}, loops AS (
        SELECT session, keyframe, unnest(loops) AS l FROM graph_poses WHERE site = ${literal(site)})
      SELECT o.session, o.keyframe, l['session'] AS other_session, l['keyframe'] AS other_keyframe,
        l['residual_m'] AS residual_m, l['weight'] AS weight, a.x AS ax, a.y AS ay, b.x AS bx, b.y AS by
      FROM loops o JOIN at a ON a.session = o.session AND a.keyframe = o.keyframe
      JOIN at b ON b.session = l['session'] AND b.keyframe = l['keyframe']`,
    draw: (rows) => ({
      features: rows.map((row) => line([[row.ax, row.ay], [row.bx, row.by]], { row, colour: colours.ramp(row.residual_m / 0.2, 0.9), width: row.weight < 0.5 ? 1 : 2, dashed: row.weight < 0.5 })),
      note: "yellow: 0.2 m and more; dashed: not believed",
    }),
  },
  {
    id: "parking_spaces", name: "parking spaces", needs: ["parking_spaces"], on: true, key: ["box", colours.GREEN],
    query: (site) => `WITH seen AS (
        SELECT session, max(stamp) AS seen FROM poses WHERE site = ${literal(site)} GROUP BY session),
      latest AS (
        SELECT o.space, last_value(o.state ORDER BY seen.seen) AS state,
          last_value(o.session ORDER BY seen.seen) AS seen_by
        FROM space_occupancy o JOIN seen ON seen.session = o.session
        WHERE o.site = ${literal(site)} AND o.state <> 'unseen' GROUP BY o.space)
      SELECT s.space, s.row, s.place, s.standing, s.probability, s.map_from_space, s.length_m, s.width_m, state, seen_by
      FROM parking_spaces s LEFT JOIN latest ON latest.space = s.space WHERE s.site = ${literal(site)}`,
    needsToo: ["space_occupancy", "poses"],
    draw: (rows) => ({
      features: rows.map((row) => box(row.map_from_space, row.length_m, row.width_m, { row, colour: row.state === "taken" ? colours.VERMILION : colours.GREEN, dashed: row.standing === "found", fill: row.state ? 0.25 : 0 })),
      note: "filled: seen; orange-red: taken; dashed: found, not said",
    }),
    where: key("space"),
  },
  {
    id: "placed_labels", name: "what people said", needs: ["placed_labels"], key: ["box", colours.PURPLE],
    query: (site) => `SELECT label, kind, standing, author, shape, map_from_label, length_m, width_m, points FROM placed_labels WHERE site = ${literal(site)}`,
    draw: (rows) => ({
      features: rows.filter((row) => row.points?.length > 1).map((row) => outline(row.points, row.shape !== "polyline", { row, colour: colours.PURPLE, dashed: row.standing === "rejected" })),
      note: "dashed: rejected",
    }),
    where: key("label"),
  },
  {
    id: "questions", name: "what the map asks", needs: ["questions"], key: ["box", colours.YELLOW],
    query: (site) => `SELECT question, kind, probability, gain, reason, map_from_label, length_m, width_m FROM questions WHERE site = ${literal(site)}`,
    draw: (rows) => ({ features: rows.map((row) => box(row.map_from_label, row.length_m, row.width_m, { row, colour: colours.YELLOW, dashed: true })) }),
    where: key("kind", "question"),
  },
  {
    id: "people_on_ground", name: "people who were seen", needs: ["people_on_ground"], key: ["dot", colours.PURPLE],
    query: (site) => `SELECT session, camera, person, x, y, probability, sqrt(var_x_m2 + var_y_m2) AS sigma_m FROM people_on_ground WHERE site = ${literal(site)}`,
    draw: (rows) => ({ features: rows.map((row) => point([row.x, row.y], { row, colour: colours.faint(colours.PURPLE, 0.4 + 0.6 * row.probability), radius: 4 })) }),
    where: key("session", "person"),
  },
  {
    id: "views", name: "semantic views", needs: ["views"], key: ["dot", colours.GREEN],
    query: (site) => `SELECT "view", session, map_from_view['x'] AS x, map_from_view['y'] AS y FROM views WHERE site = ${literal(site)}`,
    draw: (rows) => ({ features: rows.filter((row) => row.x !== null).map((row) => point([row.x, row.y], { row, colour: colours.GREEN, radius: 5 })) }),
    where: key("session", "view"),
  },
];

function grouped(rows) {
  const groups = new Map();
  for (const row of rows) {
    if (!groups.has(row.session)) groups.set(row.session, []);
    groups.get(row.session).push(row);
  }
  return groups;
}
