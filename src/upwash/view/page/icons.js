// What stands for the drone and for home on the map.

import { divIcon } from "./leaflet/leaflet-src.esm.js";
import { styleOf } from "./badge.js";
import { drawn, element } from "./element.js";

const ROTORS = [[8, 8], [24, 8], [8, 24], [24, 24]];

// Of several drones each has its number on it, in its colour.
export function droneIcon(number) {
  const arms = drawn("path", { d: "M9 9 23 23M23 9 9 23", class: "arms" });
  const rotors = ROTORS.map(([cx, cy]) => drawn("circle", { cx, cy, r: 5, class: "rotor" }));
  const body = drawn("circle", { cx: 16, cy: 16, r: number === null ? 4.5 : 8, class: "body" });
  if (number === null) return icon("drone", 32, [16, 16], arms, ...rotors, body);
  const digit = drawn("text", { x: 16, y: 20, "text-anchor": "middle", class: "digit" }, String(number));
  return icon(`drone ${styleOf(number)}`, 32, [16, 16], arms, ...rotors, body, digit);
}

// Beside its place, where the first call may be marked.
export function homeIcon() {
  return icon("home", 18, [22, 6], drawn("path", { d: "M9 1 17 8H15V17H3V8H1Z" }));
}

function icon(className, size, iconAnchor, ...shapes) {
  const picture = drawn("svg", { viewBox: `0 0 ${size} ${size}`, width: size, height: size }, ...shapes);
  return divIcon({ html: element("span", {}, picture), className, iconSize: [size, size], iconAnchor });
}
