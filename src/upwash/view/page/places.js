// How calls look everywhere: where one ran has a colour and a shape, and what it ran is told by the fill.

import { drawn } from "./element.js";

const SHAPES = [ // corners of the servers' marks, on a circle of radius 1
  [[0.8, 0.8], [-0.8, 0.8], [-0.8, -0.8], [0.8, -0.8]],
  [[0, -1.1], [1, 0.75], [-1, 0.75]],
  [[0, -1.2], [1, 0], [0, 1.2], [-1, 0]],
  [[0, 1.1], [-1, -0.75], [1, -0.75]],
  [0, 1, 2, 3, 4].map((turn) => [Math.sin((turn * 2 * Math.PI) / 5), -1.15 * Math.cos((turn * 2 * Math.PI) / 5)]),
];

const DASHES = ["7 4", "2 3", "13 3 3 3"]; // of the servers' ranges

const NAMES = new Intl.Collator("en", { numeric: true });

const FILLS = ["filled", "hollow", "dotted"]; // of operations, in the order of their names
export const FILL_WORDS = { filled: "filled", hollow: "hollow", dotted: "with a dot" };

// The colours of the style sheet, for what is drawn on a canvas.
export class Colours {
  #known = new Map();

  constructor(changed) {
    this.changed = changed;
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.forget());
  }

  // They are others from now on.
  forget() {
    this.#known.clear();
    this.changed();
  }

  of(name) {
    if (!this.#known.has(name)) {
      const style = getComputedStyle(document.documentElement);
      this.#known.set(name, style.getPropertyValue(`--${name}`).trim());
    }
    return this.#known.get(name);
  }
}

export class Places {
  #servers = [];
  operations = [];

  constructor(colours) {
    this.colours = colours;
  }

  // Makes room for these; whether any was new.
  know(servers, operations) {
    const [allServers, allOperations] = [union(this.#servers, servers), union(this.operations, operations)];
    const isNew = allServers.length > this.#servers.length || allOperations.length > this.operations.length;
    if (isNew) [this.#servers, this.operations] = [allServers, allOperations];
    return isNew;
  }

  style(place) {
    return place === "local" ? "place-0" : `place-${1 + (this.#number(place) % this.colours.of("servers"))}`;
  }

  dashes(server) {
    return DASHES[this.#number(server) % DASHES.length];
  }

  colour(place) {
    return this.colours.of(this.style(place));
  }

  fill(operation) {
    return FILLS[Math.max(0, this.operations.indexOf(operation)) % FILLS.length];
  }

  // Draws the mark of a call; with a `rim` of the ground's colour where marks may touch, in pixels.
  paint(context, { place, operation }, x, y, radius, rim = 0) {
    const [fill, colour, ground] = [this.fill(operation), this.colour(place), this.colours.of("paper")];
    const line = fill === "filled" ? 0 : Math.min(1.6, radius / 2);
    context.globalAlpha = 1;
    context.setLineDash([]);
    this.#trace(context, place, x, y, radius);
    if (rim) {
      context.strokeStyle = ground;
      context.lineWidth = line + 2 * rim;
      context.stroke();
    }
    context.fillStyle = fill === "filled" ? colour : ground;
    context.fill();
    if (fill === "filled") return;
    context.strokeStyle = colour;
    context.lineWidth = line;
    context.stroke();
    if (fill !== "dotted") return;
    context.beginPath();
    context.arc(x, y, 0.35 * radius, 0, 2 * Math.PI);
    context.fillStyle = colour;
    context.fill();
  }

  // Begins a path that is the place's mark.
  #trace(context, place, x, y, radius) {
    context.beginPath();
    if (place === "local") {
      context.arc(x, y, radius, 0, 2 * Math.PI);
      return;
    }
    for (const [right, down] of this.#corners(place)) context.lineTo(x + radius * right, y + radius * down);
    context.closePath();
  }

  // The mark as a picture; of a call of that operation, if one is given.
  icon(place, operation = null) {
    const fill = operation === null ? "filled" : this.fill(operation);
    const mark =
      place === "local"
        ? drawn("circle", { cx: 8, cy: 8, r: 5 })
        : drawn("polygon", { points: this.#corners(place).map(([x, y]) => `${8 + 5 * x},${8 + 5 * y}`).join(" ") });
    mark.setAttribute("class", `mark ${this.style(place)} ${fill}`);
    const dot = fill === "dotted" ? [drawn("circle", { cx: 8, cy: 8, r: 1.8, class: `mark ${this.style(place)}` })] : [];
    return drawn("svg", { viewBox: "0 0 16 16", width: 16, height: 16, "aria-hidden": "true" }, mark, ...dot);
  }

  #corners(place) {
    return SHAPES[this.#number(place) % SHAPES.length];
  }

  // Of a server; another world may have more.
  #number(place) {
    return Math.max(0, this.#servers.indexOf(place));
  }
}

function union(some, others) {
  return [...new Set([...some, ...others])].sort(byName);
}

// The order of names as people count: pole2 before pole10. `support/text.py` has the same.
export function byName(one, other) {
  return NAMES.compare(one, other) || (one < other ? -1 : Number(one > other));
}

// An operation as people call it, beside these others: "detector (heavy)" for detector.process_photo[heavy]; with the method
// where the service has several.
export function titleOf(operation, operations) {
  const { service, method, mode } = partsOf(operation);
  const methods = new Set(operations.map(partsOf).filter((each) => each.service === service).map((each) => each.method));
  const title = [service, methods.size > 1 ? method : ""].filter(Boolean).join(" ").replaceAll("_", " ");
  return mode ? `${title} (${mode})` : title;
}

function partsOf(operation) {
  const [, service, method = "", mode = ""] = /^(.*?)(?:\.(.*?))?(?:\[(.*)\])?$/s.exec(operation);
  return { service, method, mode };
}

export function nameOf(place) {
  return place === "local" ? "drone" : place;
}

// In a sentence.
export function theNameOf(place) {
  return place === "local" ? "the drone" : place;
}

// The name in at most so many characters: its beginning and its end, which names of one kind differ by.
export function inBrief(name, most) {
  const letters = [...name];
  const head = Math.floor((most - 1) / 3);
  if (letters.length <= most) return name;
  return [...letters.slice(0, head), "…", ...letters.slice(head + 1 - most)].join("");
}
