// The flight from above, in metres from home: plan, ranges, the way flown, calls, and the drone.

import * as L from "./leaflet/leaflet-src.esm.js";
import { drawn, element, write } from "./element.js";
import { Track } from "./track.js";

const STACKED_PX = 9; // several calls at one place stand beside each other

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

export class FlightMap {
  #plan = null;
  #moved = false; // by a person, so that nothing else moves it
  #marks = [];
  #chips = new Map();

  constructor(name, places) {
    this.places = places;
    this.frame = element("div", { class: "map" });
    this.readout = element("p", { class: "readout" });
    this.element = element("div", { class: "map-frame" }, this.frame, this.readout);
    this.map = L.map(this.frame, {
      crs: L.CRS.Simple,
      preferCanvas: true,
      attributionControl: false,
      zoomControl: false,
      minZoom: -6,
      maxZoom: 6,
      zoomSnap: 0.25,
      zoomDelta: 0.5,
    });
    this.frame.setAttribute("role", "application");
    this.frame.setAttribute("aria-label", `Map of ${name}; arrow keys move it, plus and minus zoom`);
    L.control.zoom({ position: "topleft" }).addTo(this.map);
    L.control.scale({ imperial: false, position: "bottomright" }).addTo(this.map);
    this.#addFit();
    this.plans = L.layerGroup().addTo(this.map);
    this.track = new Track(this.map, () => this.#lineStyle());
    this.calls = L.layerGroup().addTo(this.map);
    this.drone = L.marker([0, 0], { icon: droneIcon(), interactive: false, keyboard: false, zIndexOffset: 1000 });
    this.map.setView([0, 0], 0);
    this.map.on("dragstart zoomstart", (event) => (this.#moved ||= event.type === "dragstart" || this.#byHand));
    this.map.on("mousemove", (event) => this.#readOut(event.latlng));
    this.map.on("move", () => this.#readOut(this.map.getCenter()));
    this.frame.addEventListener("wheel", () => (this.#byHand = true), { passive: true });
    this.frame.addEventListener("keydown", () => (this.#byHand = true));
    this.frame.addEventListener("pointerdown", () => (this.#byHand = true));
    new ResizeObserver(() => {
      this.map.invalidateSize({ animate: false });
      if (!this.#moved) this.fit();
    }).observe(this.frame);
  }

  #byHand = false;

  #addFit() {
    const button = element("button", { type: "button", class: "fit", title: "Show all of the flight" }, "Show all");
    button.addEventListener("click", () => {
      this.#moved = this.#byHand = false;
      this.fit();
    });
    L.DomEvent.disableClickPropagation(button);
    const control = new L.Control({ position: "topright" });
    control.onAdd = () => button;
    control.addTo(this.map);
  }

  fit() {
    if (!this.#plan) return;
    const corners = [[0, 0], ...this.#plan.waypoints_m.map(([east, north]) => [north, east])];
    for (const [east, north, radius] of Object.values(this.#plan.ranges)) {
      corners.push([north - radius, east - radius], [north + radius, east + radius]);
    }
    this.map.fitBounds(L.latLngBounds(corners), { padding: [18, 18], animate: false });
  }

  #readOut(place) {
    const metres = `${place.lng.toFixed(0)} m east, ${place.lat.toFixed(0)} m north of home`;
    write(this.readout, [metres, this.degrees(place.lng, place.lat)].filter(Boolean).join(" · "));
  }

  degrees(east, north) {
    if (!this.#plan?.home) return "";
    const [latitude, longitude] = this.#plan.home;
    const [perEast, perNorth] = this.#plan.metres_per_degree;
    return `${(latitude + north / perNorth).toFixed(6)}°, ${(longitude + east / perEast).toFixed(6)}°`;
  }

  #lineStyle() {
    return { color: this.places.colours.of("ink"), weight: 2, opacity: 0.6, interactive: false };
  }

  show(moment) {
    if (moment.story.plan !== this.#plan) {
      this.#plan = moment.story.plan;
      this.#drawPlan();
      this.fit();
    }
    const position = moment.position;
    this.track.show(moment.story.fix, moment.count("fix"), position);
    this.#showCalls(moment);
    this.#showStates(moment);
    if (position) this.drone.setLatLng([position.north_m, position.east_m]).addTo(this.map);
    else this.drone.remove();
  }

  // Draws everything anew, in other colours.
  restyle(moment) {
    this.#plan = null;
    this.track.clear();
    this.calls.clearLayers();
    this.#marks = [];
    const moved = this.#moved;
    const [centre, zoom] = [this.map.getCenter(), this.map.getZoom()];
    this.show(moment);
    if (moved) this.map.setView(centre, zoom, { animate: false });
  }

  #drawPlan() {
    this.plans.clearLayers();
    this.#chips.clear();
    if (!this.#plan) return;
    const ink = this.places.colours.of("soft");
    const way = this.#plan.waypoints_m.map(([east, north]) => [north, east]);
    for (const [server, [east, north, radius]] of Object.entries(this.#plan.ranges)) {
      this.#drawRange(server, [north, east], radius);
    }
    L.polyline(way, { color: ink, weight: 1, dashArray: "2 4", interactive: false }).addTo(this.plans);
    for (const place of way) {
      L.circleMarker(place, { radius: 2, weight: 0, fillColor: ink, fillOpacity: 1, interactive: false }).addTo(this.plans);
    }
    L.marker([0, 0], { icon: homeIcon(), interactive: false, keyboard: false }).addTo(this.plans);
  }

  #drawRange(server, centre, radius) {
    const color = this.places.colour(server);
    L.circle(centre, { radius, color, weight: 1.5, dashArray: "7 4", fillOpacity: 0.07, interactive: false }).addTo(this.plans);
    const state = element("span", { class: "state" });
    const chip = element("span", { class: "chip" }, this.places.icon(server), server, " ", state);
    this.#chips.set(server, state);
    const icon = L.divIcon({ html: chip, className: "server", iconSize: null });
    L.marker(centre, { icon, interactive: false, keyboard: false }).addTo(this.plans);
  }

  #showStates(moment) {
    for (const [server, chip] of this.#chips) {
      const step = moment.step(server);
      write(chip, step?.state ?? "AVL");
      chip.className = `state ${step?.tone ?? "aside"}`;
    }
  }

  #showCalls(moment) {
    const count = moment.count("call");
    while (this.#marks.length > count) this.calls.removeLayer(this.#marks.pop());
    while (this.#marks.length < count) {
      const mark = this.#callMark(moment.story.call, this.#marks.length);
      this.#marks.push(mark);
      this.calls.addLayer(mark);
    }
  }

  #callMark(calls, index) {
    const { place, east_m, north_m } = calls[index];
    let before = index;
    while (before > 0 && calls[before - 1].east_m === east_m && calls[before - 1].north_m === north_m) before -= 1;
    return new Mark([north_m ?? 0, east_m ?? 0], {
      places: this.places,
      place,
      aside: STACKED_PX * (index - before),
      radius: 5,
      color: this.places.colours.of("paper"),
      weight: 1,
      fillColor: this.places.colour(place),
      fillOpacity: 1,
      interactive: false,
    });
  }
}

function droneIcon() {
  const arms = drawn("path", { d: "M9 9 23 23M23 9 9 23", class: "arms" });
  const rotors = [[8, 8], [24, 8], [8, 24], [24, 24]].map(([cx, cy]) => drawn("circle", { cx, cy, r: 5, class: "rotor" }));
  const body = drawn("circle", { cx: 16, cy: 16, r: 4.5, class: "body" });
  const picture = drawn("svg", { viewBox: "0 0 32 32", width: 32, height: 32 }, arms, ...rotors, body);
  return L.divIcon({ html: element("span", {}, picture), className: "drone", iconSize: [32, 32] });
}

function homeIcon() {
  const house = drawn("path", { d: "M9 1 17 8H15V17H3V8H1Z" });
  const picture = drawn("svg", { viewBox: "0 0 18 18", width: 18, height: 18 }, house);
  return L.divIcon({ html: element("span", {}, picture), className: "home", iconSize: [18, 18], iconAnchor: [22, 6] });
}
