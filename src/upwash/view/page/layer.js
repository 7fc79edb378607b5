// One flight on the map: its plan, the way flown, its calls, the drone, and the line to the server that it uses.

import * as L from "./leaflet/leaflet-src.esm.js";
import { styleOf } from "./badge.js";
import { droneIcon } from "./icons.js";
import { Track } from "./track.js";

export const STILL = { interactive: false, keyboard: false };
const STACKED_PX = 9; // several calls at one place stand beside each other
const ABOVE = 1000; // of the drone's mark; that of the drone in focus is above the others'

// A place's mark on the map's canvas, drawn as Leaflet draws its circles.
const Mark = L.CircleMarker.extend({
  _updatePath() {
    const renderer = this._renderer;
    if (!renderer._drawing || this._empty()) return;
    const { places, place, aside } = this.options;
    places.trace(renderer._ctx, place, this._point.x + aside, this._point.y, this._radius);
    renderer._fillStroke(renderer._ctx, this);
  },
});

// Where the drone turned back: a hooked arrow above the place.
const Turn = L.CircleMarker.extend({
  _updatePath() {
    const renderer = this._renderer;
    if (!renderer._drawing || this._empty()) return;
    const [context, { x, y }] = [renderer._ctx, this._point];
    context.beginPath();
    context.moveTo(x - 4, y - 6);
    context.lineTo(x - 4, y - 13);
    context.arc(x, y - 13, 4, Math.PI, 0);
    context.lineTo(x + 4, y - 6);
    context.moveTo(x + 1, y - 9);
    context.lineTo(x + 4, y - 6);
    context.lineTo(x + 7, y - 9);
    renderer._fillStroke(context, this);
  },
});

export class FlightLayer {
  #marks = { call: [], turn: [] };

  // Of the drone of that `number`; the only one there is has none.
  constructor(map, ground, places, { number = null, chosen = null } = {}) {
    this.map = map;
    this.ground = ground;
    this.places = places;
    this.number = number;
    this.plan = null;
    this.plans = L.layerGroup().addTo(map);
    this.track = new Track(map, { latLng: (east, north) => this.latLng(east, north) }, () => this.#lineStyle());
    this.calls = L.layerGroup().addTo(map); // and turns back
    const still = chosen ? { keyboard: false } : STILL;
    this.drone = L.marker([0, 0], { ...still, icon: droneIcon(number), zIndexOffset: ABOVE });
    if (chosen) this.drone.on("click", chosen);
    this.link = null;
  }

  latLng(east, north) {
    return this.ground.latLng(east, north, this.plan);
  }

  // Draws the plan, and everything else anew with what is shown next.
  begin(plan) {
    this.plan = plan;
    this.track.clear();
    this.calls.clearLayers();
    this.plans.clearLayers();
    this.#marks = { call: [], turn: [] };
    this.link?.remove();
    this.link = null;
    if (plan) this.#drawPlan();
  }

  focus(isFocus) {
    this.drone.setZIndexOffset(isFocus ? 2 * ABOVE : ABOVE);
    this.drone.getElement()?.classList.toggle("focus", isFocus);
    this.isFocus = isFocus;
  }

  show(moment) {
    const { position } = moment;
    this.track.show(moment.story.fix, moment.count("fix"), position);
    this.#showMarks(moment, "call", (calls, index) => this.#callMark(calls, index));
    this.#showMarks(moment, "turn", (turns, index) => this.#turnMark(turns[index]));
    if (this.number !== null) this.#showLink(moment, position);
    if (!position) {
      this.drone.remove();
      return;
    }
    this.drone.setLatLng(this.latLng(position.east_m, position.north_m)).addTo(this.map);
    this.focus(this.isFocus);
  }

  get #colour() {
    return this.places.colours.of(this.number === null ? "ink" : styleOf(this.number));
  }

  #lineStyle() {
    return { color: this.#colour, weight: 2, opacity: this.number === null ? 0.6 : 0.85, ...STILL };
  }

  #drawPlan() {
    const soft = this.places.colours.of("soft");
    const way = this.plan.waypoints_m.map(([east, north]) => this.latLng(east, north));
    const color = this.number === null ? soft : this.#colour;
    L.polyline(way, { ...STILL, color, weight: 1, dashArray: "2 4" }).addTo(this.plans);
    for (const place of way) {
      L.circleMarker(place, { ...STILL, radius: 2, weight: 0, fillColor: soft, fillOpacity: 1 }).addTo(this.plans);
    }
  }

  // From the drone to the server that it uses; dashed while that is being checked.
  #showLink(moment, position) {
    const [used] = moment.using;
    const range = used && this.plan?.ranges[used.server];
    if (!range || !position) {
      this.link?.remove();
      this.link = null;
      return;
    }
    this.link ??= L.polyline([], { ...STILL, color: this.#colour, weight: 2.5 }).addTo(this.map);
    const dashArray = used.tone === "ready" ? null : "3 6";
    if (this.link.options.dashArray !== dashArray) this.link.setStyle({ dashArray });
    this.link.setLatLngs([this.latLng(position.east_m, position.north_m), this.latLng(range[0], range[1])]);
  }

  #showMarks(moment, kind, made) {
    const marks = this.#marks[kind];
    const count = moment.count(kind);
    while (marks.length > count) this.calls.removeLayer(marks.pop());
    while (marks.length < count) {
      const mark = made(moment.story[kind], marks.length);
      marks.push(mark);
      this.calls.addLayer(mark);
    }
  }

  #turnMark({ east_m, north_m }) {
    const style = { radius: 9, color: this.#colour, weight: 1.6, fill: false };
    return new Turn(this.latLng(east_m, north_m), { ...style, ...STILL });
  }

  #callMark(calls, index) {
    const { place, east_m, north_m } = calls[index];
    let before = index;
    while (before > 0 && calls[before - 1].east_m === east_m && calls[before - 1].north_m === north_m) before -= 1;
    return new Mark(this.latLng(east_m ?? 0, north_m ?? 0), {
      places: this.places,
      place,
      aside: STACKED_PX * (index - before),
      radius: 5,
      color: this.places.colours.of("paper"),
      weight: 1,
      fillColor: this.places.colour(place),
      fillOpacity: 1,
      ...STILL,
    });
  }
}
