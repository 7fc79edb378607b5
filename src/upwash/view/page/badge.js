// The mark of one of several drones: its number in its colour.

import { element } from "./element.js";

const COLOURS = 8; // --drone-1 to --drone-8

export function styleOf(number) {
  return `drone-${1 + ((number - 1) % COLOURS)}`;
}

export function badge(number, tone = "") {
  return element("span", { class: `badge ${styleOf(number)} ${tone}`.trim() }, String(number));
}
