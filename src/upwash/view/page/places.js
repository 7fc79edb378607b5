// How the drone and each server look everywhere: a colour and a shape, so that neither is needed alone.

import { drawn } from "./element.js";

const SHAPES = [ // corners of the servers' marks, on a circle of radius 1
  [[0.8, 0.8], [-0.8, 0.8], [-0.8, -0.8], [0.8, -0.8]],
  [[0, -1.1], [1, 0.75], [-1, 0.75]],
  [[0, -1.2], [1, 0], [0, 1.2], [-1, 0]],
  [[0, 1.1], [-1, -0.75], [1, -0.75]],
  [0, 1, 2, 3, 4].map((turn) => [Math.sin((turn * 2 * Math.PI) / 5), -1.15 * Math.cos((turn * 2 * Math.PI) / 5)]),
];

// The colours of the style sheet, for what is drawn on a canvas.
export class Colours {
  #known = new Map();

  constructor(changed) {
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.#known.clear();
      changed();
    });
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

  constructor(colours) {
    this.colours = colours;
  }

  // Makes room for these servers; whether any was new.
  know(servers) {
    const all = [...new Set([...this.#servers, ...servers])].sort();
    const more = all.length > this.#servers.length;
    this.#servers = all;
    return more;
  }

  style(place) {
    return place === "local" ? "place-0" : `place-${1 + (this.#servers.indexOf(place) % this.colours.of("servers"))}`;
  }

  colour(place) {
    return this.colours.of(this.style(place));
  }

  // Begins a path that is the place's mark.
  trace(context, place, x, y, radius) {
    context.beginPath();
    if (place === "local") {
      context.arc(x, y, radius, 0, 2 * Math.PI);
      return;
    }
    for (const [right, down] of this.#corners(place)) context.lineTo(x + radius * right, y + radius * down);
    context.closePath();
  }

  icon(place) {
    const mark =
      place === "local"
        ? drawn("circle", { cx: 8, cy: 8, r: 5 })
        : drawn("polygon", { points: this.#corners(place).map(([x, y]) => `${8 + 5 * x},${8 + 5 * y}`).join(" ") });
    mark.setAttribute("class", `mark ${this.style(place)}`);
    return drawn("svg", { viewBox: "0 0 16 16", width: 16, height: 16, "aria-hidden": "true" }, mark);
  }

  #corners(place) {
    return SHAPES[this.#servers.indexOf(place) % SHAPES.length];
  }
}

export function nameOf(place) {
  return place === "local" ? "drone" : place;
}

// In a sentence.
export function theNameOf(place) {
  return place === "local" ? "the drone" : place;
}
