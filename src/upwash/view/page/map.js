// The flight from above, in metres from home or over map tiles: plan, ranges, the way flown, calls, and the drone.

import * as L from "./leaflet/leaflet-src.esm.js";
import { element, write } from "./element.js";
import { Ground } from "./ground.js";
import { droneIcon, homeIcon } from "./icons.js";
import { Track } from "./track.js";

const STILL = { interactive: false, keyboard: false };
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

  constructor(name, places, tiles) {
    this.places = places;
    this.ground = new Ground(tiles);
    this.frame = element("div", { class: "map" });
    this.readout = element("p", { class: "readout" });
    this.element = element("div", { class: "map-frame" }, this.frame, this.readout);
    this.map = L.map(this.frame, {
      ...this.ground.options,
      preferCanvas: true,
      attributionControl: false,
      zoomControl: false,
    });
    this.frame.setAttribute("role", "application");
    this.frame.setAttribute("aria-label", `Map of ${name}; arrow keys move it, plus and minus zoom`);
    L.control.zoom({ position: "topleft" }).addTo(this.map);
    L.control.scale({ imperial: false, position: "bottomright" }).addTo(this.map);
    this.#addFit();
    this.plans = L.layerGroup().addTo(this.map);
    this.track = new Track(this.map, this.ground, () => this.#lineStyle());
    this.calls = L.layerGroup().addTo(this.map);
    this.drone = L.marker([0, 0], { ...STILL, icon: droneIcon(), zIndexOffset: 1000 });
    this.map.setView([0, 0], this.ground.options.minZoom);
    this.map.on("mousemove", (event) => this.#readOut(event.latlng));
    this.map.on("move", () => this.#readOut(this.map.getCenter()));
    for (const touch of ["wheel", "keydown", "pointerdown"]) {
      this.frame.addEventListener(touch, () => (this.#moved = true), { passive: true });
    }
    new ResizeObserver(() => {
      this.map.invalidateSize({ animate: false });
      if (!this.#moved) this.fit();
    }).observe(this.frame);
  }

  #addFit() {
    const button = element("button", { type: "button", class: "fit", title: "Show all of the flight" }, "Show all");
    button.addEventListener("click", () => {
      this.#moved = false;
      this.fit();
    });
    L.DomEvent.disableClickPropagation(button);
    const control = new L.Control({ position: "topright" });
    control.onAdd = () => button;
    control.addTo(this.map);
  }

  fit() {
    if (!this.#plan) return;
    const corners = [[0, 0], ...this.#plan.waypoints_m];
    for (const [east, north, radius] of Object.values(this.#plan.ranges)) {
      corners.push([east - radius, north - radius], [east + radius, north + radius]);
    }
    const bounds = L.latLngBounds(corners.map(([east, north]) => this.ground.latLng(east, north)));
    this.map.fitBounds(bounds, { padding: [18, 18], animate: false });
  }

  #readOut(place) {
    const [east, north] = this.ground.metres(place);
    const metres = `${east.toFixed(0)} m east, ${north.toFixed(0)} m north of home`;
    const parts = [metres, this.ground.degrees(east, north), this.ground.tiles?.credit];
    write(this.readout, parts.filter(Boolean).join(" · "));
  }

  #lineStyle() {
    return { color: this.places.colours.of("ink"), weight: 2, opacity: 0.6, ...STILL };
  }

  show(moment) {
    if (moment.story.plan !== this.#plan) {
      this.#plan = moment.story.plan;
      this.ground.settle(this.#plan);
      this.#begin();
      this.#drawPlan();
      this.fit();
    }
    const position = moment.position;
    this.track.show(moment.story.fix, moment.count("fix"), position);
    this.#showCalls(moment);
    this.#showStates(moment);
    if (position) this.drone.setLatLng(this.ground.latLng(position.east_m, position.north_m)).addTo(this.map);
    else this.drone.remove();
  }

  // Draws everything anew, in other colours.
  restyle(moment) {
    this.#plan = undefined;
    const moved = this.#moved;
    const [centre, zoom] = [this.map.getCenter(), this.map.getZoom()];
    this.show(moment);
    if (moved) this.map.setView(centre, zoom, { animate: false });
  }

  #begin() {
    this.track.clear();
    this.calls.clearLayers();
    this.plans.clearLayers();
    this.#marks = [];
    this.#chips.clear();
  }

  #drawPlan() {
    if (!this.#plan) return;
    this.ground.layer()?.addTo(this.plans);
    const ink = this.places.colours.of("soft");
    const way = this.#plan.waypoints_m.map(([east, north]) => this.ground.latLng(east, north));
    for (const [server, [east, north, radius]] of Object.entries(this.#plan.ranges)) {
      this.#drawRange(server, this.ground.latLng(east, north), radius);
    }
    L.polyline(way, { ...STILL, color: ink, weight: 1, dashArray: "2 4" }).addTo(this.plans);
    for (const place of way) {
      L.circleMarker(place, { ...STILL, radius: 2, weight: 0, fillColor: ink, fillOpacity: 1 }).addTo(this.plans);
    }
    L.marker(this.ground.latLng(0, 0), { ...STILL, icon: homeIcon() }).addTo(this.plans);
  }

  #drawRange(server, centre, radius) {
    const color = this.places.colour(server);
    const line = { ...STILL, color, weight: 1.5, dashArray: "7 4", fillOpacity: 0.07 };
    L.circle(centre, { ...line, radius }).addTo(this.plans);
    const state = element("span", { class: "state" });
    const chip = element("span", { class: "chip" }, this.places.icon(server), server, " ", state);
    this.#chips.set(server, state);
    const icon = L.divIcon({ html: chip, className: "server", iconSize: null });
    L.marker(centre, { ...STILL, icon }).addTo(this.plans);
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
    return new Mark(this.ground.latLng(east_m ?? 0, north_m ?? 0), {
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
