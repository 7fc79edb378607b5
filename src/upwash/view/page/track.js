// The way flown, as a line that grows and shrinks at its end without being drawn anew; stronger where the drone was just now.

import { Polyline } from "./leaflet/leaflet-src.esm.js";

const ASIDE_M = 0.25; // that a fix may lie beside the line, which nobody sees
const LEAST_M = 0.5; // that a fix is away from the last corner, to tell which way that leads
const LONGEST_S = 10; // from a corner to the next
const RECENT_S = 60;
const PIECE = 200; // corners; only the last piece is ever touched

// A line with a border, which shows on photos too.
const Way = Polyline.extend({
  _updatePath() {
    const { options } = this;
    this.options = Object.assign(Object.create(options), { color: options.border, weight: options.weight + 2, opacity: 1 });
    Polyline.prototype._updatePath.call(this);
    this.options = options;
    Polyline.prototype._updatePath.call(this);
  },
});

export class Track {
  #corners = []; // indices of fixes: where the way bends
  #next = 0; // the index of the first fix that was not looked at
  #sleeve = null; // from the last corner, in which all later fixes lie
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
    this.#next = 0;
    this.#pieces = [];
    this.#head = null;
  }

  // The first `count` of the fixes, and the way from there to where the drone is at that second of the log.
  show(fixes, count, position, atS) {
    this.#shrink(fixes, count);
    this.#grow(fixes, count);
    this.#head ??= new Way([], this.recent()).addTo(this.map);
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
    this.#next = 0; // which begins anew from the last corner
    const whole = Math.ceil(this.#corners.length / PIECE);
    while (this.#pieces.length > whole) this.#pieces.pop().remove();
    if (whole) this.#pieces[whole - 1].setLatLngs(this.#piece(fixes, whole - 1));
  }

  #grow(fixes, count) {
    if (!count) return;
    const first = Math.max(0, Math.ceil(this.#corners.length / PIECE) - 1);
    const before = this.#corners.length;
    if (!before) this.#corners.push(0);
    if (!this.#next) this.#sleeve = new Sleeve(fixes[this.#corners.at(-1)]);
    this.#next ||= this.#corners.at(-1) + 1;
    for (; this.#next < count; this.#next += 1) {
      const [last, here] = [fixes[this.#next - 1], fixes[this.#next]];
      if (last.at_s - this.#sleeve.corner.at_s <= LONGEST_S && this.#sleeve.holds(here)) continue;
      this.#corners.push(this.#next - 1);
      this.#sleeve = new Sleeve(last);
      this.#sleeve.holds(here);
    }
    if (this.#corners.length === before) return;
    for (let piece = first; piece * PIECE < this.#corners.length; piece += 1) {
      this.#pieces[piece] ??= new Way([], this.style()).addTo(this.map);
      this.#pieces[piece].setLatLngs(this.#piece(fixes, piece));
    }
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

// The directions from a corner in which a line passes all fixes so far close by.
class Sleeve {
  #away = 0; // how far the farthest of them is
  #way = null; // to the first that is not at the corner, as an angle; the others' are counted from it
  #left = -Infinity;
  #right = Infinity;

  constructor(corner) {
    this.corner = corner;
  }

  // Takes in the next fix, unless it lies beside the sleeve, or the drone came back.
  holds(fix) {
    const [east, north] = [fix.east_m - this.corner.east_m, fix.north_m - this.corner.north_m];
    const away = Math.hypot(east, north);
    if (away < this.#away - LEAST_M) return false;
    if (away < LEAST_M) return true;
    const way = Math.atan2(east, north);
    this.#way ??= way;
    const turn = ((way - this.#way + 3 * Math.PI) % (2 * Math.PI)) - Math.PI;
    if (turn < this.#left || turn > this.#right) return false;
    const play = Math.asin(ASIDE_M / away);
    this.#left = Math.max(this.#left, turn - play);
    this.#right = Math.min(this.#right, turn + play);
    this.#away = Math.max(this.#away, away);
    return true;
  }
}
