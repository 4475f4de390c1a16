/** What rows were made from, step by step back to the messages of logs. */
import { literal, sql } from "./server.js";

/**
 * A fold that says what a row was made from, once it is opened.
 * @param {string} layer
 * @param {object} row its session and stamp say which messages are meant, where it has them
 * @param {number} version
 * @param {(query: string) => void} ask shows the rows of a query
 */
export function lineage(layer, row, version, ask) {
  const fold = document.createElement("details");
  fold.id = "lineage";
  fold.append(Object.assign(document.createElement("summary"), { textContent: "made from" }));
  fold.addEventListener("toggle", async () => {
    if (!fold.open || fold.children.length > 1) return;
    const of = [layer, row.session].filter((name) => typeof name === "string").map(literal);
    try {
      const found = await sql(`SELECT * FROM lineage(${of.join(", ")})`, version);
      const entries = new Map(found.map((one) => [one.entry, one]));
      fold.append(list(found.filter(({ name }) => name === layer), { entries, told: new Set(), stamp: row.stamp, ask }));
    } catch (error) {
      fold.append(Object.assign(document.createElement("p"), { textContent: error.message }));
    }
  });
  return fold;
}

function list(found, context) {
  const made = document.createElement("ul");
  made.append(...found.map((one) => item(one, context)));
  return made;
}

function item(one, context) {
  const line = document.createElement("li");
  const of = one.session ?? one.site ?? "the map";
  const rows = one.rows === null ? one.files.join(", ") : `${one.rows.toLocaleString("en")} rows`;
  const how = one.messages ? one.topics.join(", ") : one.computed.join(", ");
  line.append(Object.assign(document.createElement("b"), { textContent: one.name }), ` of ${of}: ${how ? `${how}; ` : ""}${rows}, ${one.content.slice(0, 12)}`);
  if (one.messages) {
    const button = Object.assign(document.createElement("button"), { textContent: "messages" });
    button.addEventListener("click", () => context.ask(messages(one, context.stamp)));
    line.append(" ", button);
  }
  if (context.told.has(one.entry)) {
    line.append(" (as above)");
  } else if (one.made_from.length > 0) {
    context.told.add(one.entry);
    line.append(list(one.made_from.map((number) => context.entries.get(number)), context));
  }
  return line;
}

/** The query of the messages of a log up to an instant, the last ones first; of all where there is none. */
function messages({ name, messages: query }, stamp) {
  if (stamp === null || stamp === undefined) return `${query} LIMIT 100`;
  const time = name.startsWith("/") ? "log_time" : "stamp";
  return `${query} WHERE ${time} <= '${stamp}' ORDER BY ${time} DESC LIMIT 10`;
}
