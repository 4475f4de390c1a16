/** Connected areas of a label image as polygons in its pixels. */

/** Polygons of more points are not taken by the server. */
const MOST_POINTS = 4000;

/** East, south, west, north; rows go down. */
const STEPS = [[1, 0], [0, 1], [-1, 0], [0, -1]];
/** The pixels ahead of a corner, to the left and to the right, by heading. */
const AHEAD = [[[0, -1], [0, 0]], [[0, 0], [-1, 0]], [[-1, 0], [-1, -1]], [[-1, -1], [0, -1]]];

/**
 * The areas of equal labels (four neighbours), larger before smaller: who paints them in this order paints each over what
 * encloses it. A ring goes through the middles of the sides of pixels, so that it never touches itself; the centres that it
 * encloses are those of the area and of its holes.
 * @param {Uint8Array} labels row by row
 * @param {[number, number]} size width and height
 * @param {(label: number) => boolean} counts whether a label is wanted
 * @param {number} least smaller areas are left out, px
 * @returns {{label: number, ring: number[][], area: number}[]}
 */
export function regions(labels, [width, height], counts, least) {
  const part = new Int32Array(labels.length);
  const found = [];
  let number = 0;
  for (let first = 0; first < labels.length; first += 1) {
    if (part[first] || !counts(labels[first])) continue;
    number += 1;
    if (fill(labels, part, [width, height], first, number) < least) continue;
    const mine = number;
    const is = (x, y) => x >= 0 && y >= 0 && x < width && y < height && part[y * width + x] === mine;
    const ring = outline(is, first % width, Math.floor(first / width));
    if (ring.length <= MOST_POINTS) found.push({ label: labels[first], ring, area: areaOf(ring) });
  }
  return found.sort((a, b) => b.area - a.area);
}

/** The smallest area that has a pixel in it, and then those that it encloses; none where there is none. */
export function at(found, [x, y]) {
  const centre = [Math.floor(x) + 0.5, Math.floor(y) + 0.5];
  const chosen = found.filter(({ ring }) => contains(ring, centre)).at(-1);
  if (!chosen) return [];
  return found.filter((one) => one === chosen || (one.area < chosen.area && contains(chosen.ring, one.ring[0])));
}

/** Numbers the pixels that are connected to the first; how many there are. */
function fill(labels, part, [width, height], first, number) {
  const next = [first];
  part[first] = number;
  let pixels = 0;
  while (next.length) {
    const pixel = next.pop();
    pixels += 1;
    const [x, y] = [pixel % width, Math.floor(pixel / width)];
    for (const [dx, dy] of STEPS) {
      const beside = pixel + dx + dy * width;
      const inside = x + dx >= 0 && x + dx < width && y + dy >= 0 && y + dy < height;
      if (inside && !part[beside] && labels[beside] === labels[first]) {
        part[beside] = number;
        next.push(beside);
      }
    }
  }
  return pixels;
}

/** Goes round an area, which lies to the right, from the upper side of its first pixel. */
function outline(is, startX, startY) {
  const ring = [];
  let [x, y, heading] = [startX, startY, 0];
  do {
    const [dx, dy] = STEPS[heading];
    ring.push([x + dx / 2, y + dy / 2]);
    [x, y] = [x + dx, y + dy];
    const [left, right] = AHEAD[heading].map(([aside, down]) => is(x + aside, y + down));
    heading = (heading + (!right ? 1 : left ? 3 : 0)) % 4;
  } while (x !== startX || y !== startY || heading !== 0);
  return ring.filter((point, index) => {
    const [before, after] = [ring.at(index - 1), ring[(index + 1) % ring.length]];
    return (point[0] - before[0]) * (after[1] - point[1]) !== (point[1] - before[1]) * (after[0] - point[0]);
  });
}

const sides = (ring) => ring.map((point, index) => [point, ring[(index + 1) % ring.length]]);

function areaOf(ring) {
  return Math.abs(sides(ring).reduce((sum, [a, b]) => sum + a[0] * b[1] - a[1] * b[0], 0)) / 2;
}

/** Whether a ring encloses a point. */
function contains(ring, [x, y]) {
  const crossed = sides(ring).filter(([a, b]) => a[1] > y !== b[1] > y && x < a[0] + ((y - a[1]) / (b[1] - a[1])) * (b[0] - a[0]));
  return crossed.length % 2 === 1;
}
