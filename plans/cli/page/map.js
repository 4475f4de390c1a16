/** The map itself: metres of the map frame, x to the right and y up. */
import { tile } from "./server.js";

/* global ol */

const FAR = 1e6;
const METRES = new ol.proj.Projection({ code: "map", units: "m", extent: [-FAR, -FAR, FAR, FAR], global: false });

/** @param {string} target id of the element */
export function create(target) {
  const view = new ol.View({
    projection: METRES, center: [0, 0], resolution: 0.05, minResolution: 0.002, maxResolution: 50,
    constrainResolution: false, smoothResolutionConstraint: false, showFullExtent: true,
  });
  return new ol.Map({
    target, view, layers: [], keyboardEventTarget: document.getElementById(target),
    controls: [new ol.control.Zoom(), new ol.control.ScaleLine({ minWidth: 90 })],
  });
}

/** The layer of what `draw` gave. @param {{site: string, version: number}} of */
export function layer(drawn, of, zIndex) {
  if (drawn.tiles) return tiles(drawn.tiles, of, zIndex);
  if (drawn.features) {
    return new ol.layer.Vector({ source: new ol.source.Vector({ features: drawn.features }), zIndex, updateWhileInteracting: true });
  }
  return marks(drawn.points ?? drawn.cells, drawn.cells !== undefined, zIndex);
}

function tiles(rows, { site, version }, zIndex) {
  const zooms = [...new Map(rows.map((row) => [row.zoom, row])).values()].sort((a, b) => b.zoom - a.zoom);
  const there = new Set(rows.map((row) => `${row.zoom}/${row.tile_x}/${row.tile_y}`));
  const grid = new ol.tilegrid.TileGrid({
    origin: [0, 0], resolutions: zooms.map((row) => row.cell_m), tileSizes: zooms.map((row) => Math.round(row.size_m / row.cell_m)),
    extent: METRES.getExtent(),
  });
  const source = new ol.source.TileImage({
    projection: METRES, tileGrid: grid, interpolate: true,
    // Rows of a grid are counted down from its origin, those of tiles upward.
    tileUrlFunction: ([z, x, y]) => {
      const { zoom } = zooms[z];
      return there.has(`${zoom}/${x}/${-y - 1}`) ? tile(site, version, zoom, x, -y - 1) : undefined;
    },
  });
  const made = new ol.layer.Tile({ source, zIndex });
  made.set("extent_m", extent(rows.flatMap((row) => {
    const [x, y] = [row.tile_x * row.size_m, row.tile_y * row.size_m];
    return row.zoom === zooms.at(-1).zoom ? [[x, y], [x + row.size_m, y + row.size_m]] : [];
  })));
  return made;
}

/** Dots of two pixels, or squares of `cell_m`, on one canvas: 100,000 of them are drawn in some ten milliseconds. */
function marks(given, areCells, zIndex) {
  const items = given.map(({ row, colour, at = [row.x, row.y] }) => ({ row, colour, at }));
  const canvasFunction = ([west, , , north], resolution, ratio, [width, height]) => {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const pen = canvas.getContext("2d");
    const scale = ratio / resolution;
    for (const { row, colour, at } of items) {
      const side = areCells ? Math.max(row.cell_m * scale, 1) : 2 * ratio;
      const [x, y] = [(at[0] - west) * scale - side / 2, (north - at[1]) * scale - side / 2];
      if (x < -side || y < -side || x > width || y > height) continue;
      pen.fillStyle = colour;
      pen.fillRect(x, y, side, side);
    }
    return canvas;
  };
  const source = new ol.source.ImageCanvas({ canvasFunction, projection: METRES, ratio: 1.3 });
  const made = new ol.layer.Image({ source, zIndex });
  made.set("items", items);
  made.set("cells", areCells);
  made.set("extent_m", extent(items.map(({ at }) => at)));
  return made;
}

function extent(points) {
  return points.reduce(([west, south, east, north], [x, y]) => [Math.min(west, x), Math.min(south, y), Math.max(east, x), Math.max(north, y)], [Infinity, Infinity, -Infinity, -Infinity]);
}

/** What a layer covers, m; `null` where it is empty. */
export function covered(made) {
  const found = made.get("extent_m") ?? made.getSource().getExtent();
  return found && Number.isFinite(found[0]) ? found : null;
}

/** The row at a pixel and the id of its layer: a feature there, else the nearest dot or cell. */
export function rowAt(map, shown, pixel) {
  // What is no row of anything, as the halo of what moved, lies over what is.
  const rowOf = (found, of) => found.get("row") && { row: found.get("row"), id: of?.get("id") };
  const feature = map.forEachFeatureAtPixel(pixel, rowOf, { hitTolerance: 6 });
  if (feature) return feature;
  const [x, y] = map.getCoordinateFromPixel(pixel);
  const reach = map.getView().getResolution() * 6;
  for (const [id, made] of [...shown].reverse()) {
    let best = null;
    const areCells = made.get("cells");
    for (const { row, at } of made.get("items") ?? []) {
      const apart = Math.max(Math.abs(at[0] - x), Math.abs(at[1] - y)) - (areCells ? row.cell_m / 2 : 0);
      if (apart < (best?.apart ?? (areCells ? 0 : reach))) best = { apart, row };
    }
    if (best) return { row: best.row, id };
  }
  return null;
}
