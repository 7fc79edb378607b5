// The mark of one of several drones: its number in its colour.

import { coloured, element } from "./element.js";

export function styleOf(number) {
  return `drone-${1 + ((number - 1) % coloured("drones"))}`;
}

export function badge(number, tone = "") {
  return element("span", { class: `badge ${styleOf(number)} ${tone}`.trim() }, String(number));
}
