// What stands for the drone and for home on the map.

import { divIcon } from "./leaflet/leaflet-src.esm.js";
import { styleOf } from "./badge.js";
import { drawn, element } from "./element.js";

const ROTORS = [[8, 8], [24, 8], [8, 24], [24, 24]];

// Of several drones each has its number on it, in its colour. Its nose points up, until it is turned.
export function droneIcon(number) {
  const arms = drawn("path", { d: "M9 9 23 23M23 9 9 23", class: "arms" });
  const nose = drawn("path", { d: "M16 -6 21 4H11Z", class: "nose" });
  const rotors = ROTORS.map(([cx, cy]) => drawn("circle", { cx, cy, r: 4.5, class: "rotor" }));
  const frame = drawn("g", { class: "airframe" }, arms, nose, ...rotors);
  const body = drawn("circle", { cx: 16, cy: 16, r: number === null ? 4.5 : 8, class: "body" });
  if (number === null) return icon("drone", 32, [16, 16], frame, body);
  const digit = drawn("text", { x: 16, y: 20, "text-anchor": "middle", class: "digit" }, String(number));
  return icon(`drone ${styleOf(number)}`, 32, [16, 16], frame, body, digit);
}

// Turns the drone's nose; where its heading is not known it has none.
export function turn(picture, headingDeg) {
  const frame = picture.querySelector(".airframe");
  frame.classList.toggle("astray", headingDeg === null);
  frame.setAttribute("transform", `rotate(${(headingDeg ?? 0).toFixed(0)} 16 16)`);
}

// Beside its place, where the first call may be marked.
export function homeIcon() {
  return icon("home", 18, [22, 6], drawn("path", { d: "M9 1 17 8H15V17H3V8H1Z" }));
}

function icon(className, size, iconAnchor, ...shapes) {
  const picture = drawn("svg", { viewBox: `0 0 ${size} ${size}`, width: size, height: size }, ...shapes);
  return divIcon({ html: element("span", {}, picture), className, iconSize: [size, size], iconAnchor });
}
