// Marks on the map's canvas: any number of one kind as one layer, and how each kind looks.

import * as L from "./leaflet/leaflet-src.esm.js";

const MEASURED_PX = 9;
export const STILL = { interactive: false, keyboard: false };

// As a layer, the first so many of the marks that `place` has an index for; `paint` draws one at a point, and no
// farther from it than `reach` pixels.
export const Marks = L.Path.extend({
  options: { ...STILL, weight: 0, pane: "marks" },

  initialize({ place, paint, reach, facts = null, ...options }) {
    L.setOptions(this, options);
    const reachOf = typeof reach === "function" ? reach : () => reach; // which may change with the map's scale
    Object.assign(this, { place, paint, reachOf, facts, count: 0, places: [], points: [] });
  },

  show(count) {
    if (count === this.count) return;
    const [first, last] = [Math.min(count, this.count), Math.max(count, this.count)];
    this.count = count;
    for (let index = this.places.length; index < count; index += 1) {
      this.places.push(this.place(index));
      this.points.push(this._map.latLngToLayerPoint(this.places[index]));
    }
    this.redrawSome(first, last);
  },

  // Those of the indices from `first` to before `last`, and no others.
  redrawSome(first, last) {
    const all = this._pxBounds;
    this._pxBounds = this._around(this.points.slice(first, last));
    this._renderer._requestRedraw(this);
    if (all) this._pxBounds.extend(all.min).extend(all.max);
  },

  _around(points) {
    const bounds = L.bounds(points);
    const reach = this.reachOf();
    const margin = L.point(reach, reach);
    return L.bounds(bounds.min.subtract(margin), bounds.max.add(margin));
  },

  _project() {
    this.points = this.places.map((place) => this._map.latLngToLayerPoint(place));
    this._pxBounds = this.points.length ? this._around(this.points) : null;
  },

  _update() {
    this._updatePath();
  },

  _updatePath() {
    const renderer = this._renderer;
    if (!renderer._drawing) return;
    const reach = this.reachOf();
    const { min, max } = renderer._redrawBounds ?? renderer._bounds;
    for (let index = 0; index < this.count; index += 1) {
      const { x, y } = this.points[index];
      const outside = x < min.x - reach || x > max.x + reach || y < min.y - reach || y > max.y + reach;
      if (!outside) this.paint(renderer._ctx, index, x, y);
    }
  },
});

export function paintDot(context, colour, x, y) {
  context.globalAlpha = 1;
  context.fillStyle = colour;
  context.beginPath();
  context.arc(x, y, 2, 0, 2 * Math.PI);
  context.fill();
}

// Where a server without a range was asked something: the fuller, the more was answered.
export function paintMeasured(context, colour, paper, answered, x, y) {
  context.beginPath();
  context.arc(x, y, MEASURED_PX, 0, 2 * Math.PI);
  for (const [style, alpha] of [[paper, 1], [colour, 0.35 * answered]]) {
    context.globalAlpha = alpha;
    context.fillStyle = style;
    context.fill();
  }
  context.globalAlpha = 1;
  context.strokeStyle = colour;
  context.lineWidth = 1;
  context.setLineDash(answered < 0.5 ? [2, 3] : []);
  context.stroke();
  context.setLineDash([]);
}

// The middle of a server's range.
export function paintCross(context, colour, x, y) {
  context.beginPath();
  context.moveTo(x - 5, y);
  context.lineTo(x + 5, y);
  context.moveTo(x, y - 5);
  context.lineTo(x, y + 5);
  draw(context, colour, 2);
}

// Where the drone turned back: a hooked arrow above the place.
export function paintTurn(context, colour, x, y) {
  context.beginPath();
  context.moveTo(x - 4, y - 6);
  context.lineTo(x - 4, y - 13);
  context.arc(x, y - 13, 4, Math.PI, 0);
  context.lineTo(x + 4, y - 6);
  context.moveTo(x + 1, y - 9);
  context.lineTo(x + 4, y - 6);
  context.lineTo(x + 7, y - 9);
  draw(context, colour, 1.6);
}

// A photo whose answer is not there.
export function paintOpen(context, colour, x, y, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  draw(context, colour, 1.4, [2.5, 2.5]);
}

// What was found there: a dot, and its number or a count in a pill so far from it, with a line where that is not in its place.
export function paintFinding(context, [ink, paper], { move: [right, down], words, isCurrent }, x, y) {
  context.globalAlpha = 1;
  context.setLineDash([]);
  context.strokeStyle = ink;
  const pill = (middleX, middleY, width, height) => {
    context.beginPath();
    context.roundRect(middleX - width / 2, middleY - height / 2, width, height, height / 2);
    context.fillStyle = isCurrent ? ink : paper;
    context.fill();
    context.lineWidth = 1.4;
    context.stroke();
  };
  if (right || down) {
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + right, y + down);
    draw(context, ink, 1);
  }
  if (right || down || !words) pill(x, y, DOT_PX, DOT_PX);
  if (!words) return;
  pill(x + right, y + down, pillWidth(words), PILL_PX);
  context.font = "700 10.5px system-ui, sans-serif";
  context.textAlign = "center";
  context.fillStyle = isCurrent ? paper : ink;
  context.fillText(words, x + right, y + down + 3.8);
}

export const PILL_PX = 16; // its height
export const DOT_PX = 7;

export function pillWidth(number) {
  return Math.max(PILL_PX, 8 + 6.5 * String(number).length);
}

// The number of a waypoint, beneath it.
export function paintNumber(context, [colour, ground], words, x, y) {
  context.globalAlpha = 1;
  context.setLineDash([]);
  context.font = NUMBER_FONT;
  context.textAlign = "center";
  context.lineJoin = "round";
  context.strokeStyle = ground;
  context.lineWidth = 3;
  context.strokeText(words, x, y + 17);
  context.fillStyle = colour;
  context.fillText(words, x, y + 17);
}

// What that covers.
export function numberBox(words, x, y) {
  const width = 6.5 * words.length;
  return { x: x - width / 2, y: y + 8, width, height: 11 };
}

export const NUMBER_FONT = "11px system-ui, sans-serif";

function draw(context, colour, width, dashes = []) {
  context.globalAlpha = 1;
  context.setLineDash(dashes);
  context.lineCap = context.lineJoin = "round";
  context.lineWidth = width;
  context.strokeStyle = colour;
  context.stroke();
}
