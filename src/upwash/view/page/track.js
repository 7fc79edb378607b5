// The way flown, as a line that grows and shrinks at its end without being drawn anew; stronger where the drone was just now.

import { polyline } from "./leaflet/leaflet-src.esm.js";

const LEAST_M = 0.5; // fixes closer to the last one make no corner
const RECENT_S = 60;
const PIECE = 200; // corners; only the last piece is ever touched

export class Track {
  #corners = []; // indices of fixes
  #pieces = [];
  #head;

  // `style` of what is old, and of what is `recent`.
  constructor(map, ground, style, recent) {
    this.map = map;
    this.ground = ground;
    this.style = style;
    this.recent = recent;
  }

  clear() {
    for (const piece of [...this.#pieces, ...(this.#head ? [this.#head] : [])]) piece.remove();
    this.#corners = [];
    this.#pieces = [];
    this.#head = null;
  }

  // The first `count` of the fixes, and the way from there to where the drone is at that second of the log.
  show(fixes, count, position, atS) {
    this.#shrink(fixes, count);
    this.#grow(fixes, count);
    this.#head ??= polyline([], this.recent()).addTo(this.map);
    const way = this.#corners.length && position ? [position] : [];
    for (let corner = this.#corners.length - 1; way.length && corner >= 0; corner -= 1) {
      const fix = fixes[this.#corners[corner]];
      way.push(fix);
      if (fix.at_s < atS - RECENT_S) break;
    }
    this.#head.setLatLngs(way.map((place) => this.#latLng(place)));
  }

  #shrink(fixes, count) {
    if (this.#corners.length === 0 || this.#corners.at(-1) < count) return;
    while (this.#corners.length && this.#corners.at(-1) >= count) this.#corners.pop();
    const whole = Math.ceil(this.#corners.length / PIECE);
    while (this.#pieces.length > whole) this.#pieces.pop().remove();
    if (whole) this.#pieces[whole - 1].setLatLngs(this.#piece(fixes, whole - 1));
  }

  #grow(fixes, count) {
    let next = (this.#corners.at(-1) ?? -1) + 1;
    const first = Math.max(0, Math.ceil(this.#corners.length / PIECE) - 1);
    const before = this.#corners.length;
    for (; next < count; next += 1) {
      if (this.#isCorner(fixes, next)) this.#corners.push(next);
    }
    if (this.#corners.length === before) return;
    for (let piece = first; piece * PIECE < this.#corners.length; piece += 1) {
      this.#pieces[piece] ??= polyline([], this.style()).addTo(this.map);
      this.#pieces[piece].setLatLngs(this.#piece(fixes, piece));
    }
  }

  #isCorner(fixes, index) {
    if (this.#corners.length === 0) return true;
    const [last, here] = [fixes[this.#corners.at(-1)], fixes[index]];
    return Math.hypot(here.east_m - last.east_m, here.north_m - last.north_m) >= LEAST_M;
  }

  // A piece begins where the one before it ends.
  #piece(fixes, piece) {
    const indices = this.#corners.slice(Math.max(0, piece * PIECE - 1), (piece + 1) * PIECE);
    return indices.map((index) => this.#latLng(fixes[index]));
  }

  #latLng(place) {
    return this.ground.latLng(place.east_m, place.north_m);
  }
}
