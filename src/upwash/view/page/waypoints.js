// The waypoints of a plan: the way between them, and their numbers as soon as these have room.

import * as L from "./leaflet/leaflet-src.esm.js";
import { Marks, NUMBER_FONT, STILL, numberBox, paintDot, paintNumber } from "./marks.js";

const LINE_PX = 28; // from a number to the one beneath it, with the marks between them
const GAP_PX = 6;
const SAME_M = 0.5; // waypoints closer than that are at one place

export class Waypoints {
  #numbers = null;
  #labels = [];
  #roomyAt = Infinity; // the scale, in pixels for a metre, from which on no number covers another

  // `leaves` says whether a box on the map is free for a number.
  constructor(map, leaves) {
    this.leaves = leaves;
    this.group = L.layerGroup().addTo(map);
  }

  // Draws those of the plan, if there is one.
  begin(plan, latLng, { line, soft, ink, paper }) {
    this.group.clearLayers();
    this.#labels = plan ? numbered(plan.waypoints_m) : [];
    this.#roomyAt = roomyAt(this.#labels);
    if (!plan) return;
    const way = plan.waypoints_m.map(([east, north]) => latLng(east, north));
    L.polyline(way, { ...STILL, color: line, weight: 1, dashArray: "2 4" }).addTo(this.group);
    const paint = (context, _, x, y) => paintDot(context, soft, x, y);
    const dots = new Marks({ place: (index) => way[index], paint, reach: 3, pane: "overlayPane" }).addTo(this.group);
    dots.show(way.length);
    this.#numbers = new Marks({
      place: (index) => latLng(this.#labels[index].east, this.#labels[index].north),
      paint: (context, index, x, y) => {
        const { words } = this.#labels[index];
        if (this.leaves(numberBox(words, x, y))) paintNumber(context, [ink, paper], words, x, y);
      },
      reach: 40,
    }).addTo(this.group);
  }

  redraw() {
    this.#numbers?.redraw();
  }

  // Shows the numbers if they are wanted, and there is room at that scale.
  showNumbers(wanted, pixelsPerMetre) {
    this.#numbers?.show(wanted && pixelsPerMetre >= this.#roomyAt ? this.#labels.length : 0);
  }
}

// What stands at each place: the numbers of the waypoints there.
function numbered(waypoints) {
  const labels = new Map();
  for (const [number, [east, north]] of waypoints.entries()) {
    const key = [east, north].map((metres) => Math.round(metres / SAME_M)).join();
    if (!labels.has(key)) labels.set(key, { east, north, words: String(number) });
    else labels.get(key).words += `, ${number}`;
  }
  return [...labels.values()];
}

// Two numbers have room where they are a number's width apart sideways, or a line upwards.
function roomyAt(labels) {
  if (labels.length < 2) return 0;
  const context = document.createElement("canvas").getContext("2d");
  context.font = NUMBER_FONT;
  const width = GAP_PX + Math.max(...labels.map(({ words }) => context.measureText(words).width));
  const upwards = [...labels].sort((one, other) => one.north - other.north);
  let least = Infinity; // of the distances between two, as a share of what they need at a pixel for a metre
  for (const [index, one] of upwards.entries()) {
    for (let next = index + 1; next < upwards.length; next += 1) {
      const up = (upwards[next].north - one.north) / LINE_PX;
      if (up >= least) break;
      least = Math.min(least, Math.max(up, Math.abs(upwards[next].east - one.east) / width));
    }
  }
  return 1 / least;
}
