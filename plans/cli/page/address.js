/** What is shown, as the fragment of the page's address: a link is a view. */

/**
 * @returns {{map?: string, site?: string, version?: number, x?: number, y?: number, m_per_px?: number, on?: string[], query?: string}}
 */
export function read() {
  const said = new URLSearchParams(location.hash.slice(1));
  const number = (name) => {
    const value = Number.parseFloat(said.get(name));
    return Number.isFinite(value) ? value : undefined;
  };
  return {
    site: said.get("site") ?? undefined,
    version: number("version"),
    x: number("x"),
    y: number("y"),
    m_per_px: number("m_per_px"),
    on: said.get("on")?.split(",").filter(Boolean),
    query: said.get("query") ?? undefined,
  };
}

/**
 * Says what is shown. What was chosen is a step of the browser's history; where one looks is not.
 * @param {object} view as `read` gives it
 * @param {boolean} step
 */
export function write(view, step) {
  const said = new URLSearchParams();
  for (const [name, value] of Object.entries(view)) {
    if (value === undefined || value === "") continue;
    said.set(name, Array.isArray(value) ? value.join(",") : value);
  }
  const fragment = `#${said}`;
  if (fragment === location.hash) return;
  history[step ? "pushState" : "replaceState"](null, "", fragment);
}
