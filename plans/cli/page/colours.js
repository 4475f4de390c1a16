/** Colours that everybody tells apart (Okabe and Ito 2008), and ramps between them. */

export const BLUE = "#0072b2";
export const ORANGE = "#e69f00";
export const GREEN = "#009e73";
export const VERMILION = "#d55e00";
export const SKY = "#56b4e9";
export const PURPLE = "#cc79a7";
export const YELLOW = "#f0e442";
export const GREY = "#8a8f98";

/** How the line of a session is drawn, by its place among them: not as lanes and intersections are. */
export function ofSession(place) {
  const each = [BLUE, GREEN, PURPLE, SKY, YELLOW];
  return { colour: each[place % each.length], dashed: Math.floor(place / each.length) % 2 === 1 };
}

/** How pixels of a class are drawn, by its place among the classes. */
export function ofClass(place) {
  const each = [GREEN, SKY, PURPLE, VERMILION, YELLOW, BLUE, ORANGE, "#00ffff", "#ff00ff", "#7fff00", "#8b4513", GREY];
  return each[Math.max(place, 0) % each.length];
}

/** A colour with transparency. */
export function faint(hex, alpha) {
  return hex + Math.round(alpha * 255).toString(16).padStart(2, "0");
}

/** From dark blue over green to yellow (viridis, five of its colours), for a share of 0 to 1. */
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

export function ramp(share, alpha = 1) {
  const at = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(at), RAMP.length - 2);
  const mixed = RAMP[low].map((from, channel) => Math.round(from + (RAMP[low + 1][channel] - from) * (at - low)));
  return `rgba(${mixed.join(",")},${alpha})`;
}
