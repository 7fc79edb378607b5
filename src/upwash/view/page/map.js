// Flights from above, in metres from home or over map tiles: the servers' ranges, and a layer for each flight.

import * as L from "./leaflet/leaflet-src.esm.js";
import { badge } from "./badge.js";
import { element, write } from "./element.js";
import { Ground } from "./ground.js";
import { homeIcon } from "./icons.js";
import { Labels } from "./labels.js";
import { FlightLayer } from "./layer.js";
import { Marks, STILL, paintCross } from "./marks.js";
import { inBrief } from "./places.js";
import { Pills } from "./pills.js";
import { guardWheel } from "./wheel.js";

const PAPER_PX = 660; // the width of what is printed on A4
const DRONE_PX = 36; // nothing may cover that much
const LABEL_PX = 200; // as far from its place a label may cover something
const NAME = 16; // characters of a server's, which its place in the list has whole
const DASHED_M = 10_000; // a wider circle has more dashes than a browser draws in a second
const IN_USE = { weight: 2.5, opacity: 1, fillOpacity: 0.1 };
const ASIDE = { weight: 1.2, opacity: 0.45, fillOpacity: 0.03 };

export class FlightMap {
  #plans = []; // as they are drawn
  #stale = false; // in colours that are no longer so
  #homes = []; // likewise
  #painted = null; // what the first photo shows of the ground
  #moved = false; // by a person, so that nothing else moves it
  #servers = new Map(); // as they are drawn: each with its range, its label and what is said there beside its name
  #labels = new Labels();
  #pills = new Pills();
  #stories = [];
  #found = []; // by story: what was found, as its numbers are drawn
  #current = null; // the finding that is looked at
  #only = null; // the flight whose findings are shown; those of all where it is null

  // A map of the drones of these logs; `chosen` is told the index of one that is clicked.
  constructor(name, { places, tiles, logs, chosen = null }) {
    this.places = places;
    this.found = () => {}; // is told which finding is clicked, and of which story it is
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
    for (const pane of ["mosaic", "marks"]) this.map.createPane(pane);
    this.areas = L.layerGroup().addTo(this.map);
    this.layers = logs.map((log, index) => {
      const many = logs.length > 1 ? { number: index + 1, chosen: () => chosen(index) } : {};
      return new FlightLayer(this.map, this.ground, places, this.#pills, { log, ...many });
    });
    guardWheel(this.element, "Turn the wheel with Ctrl to zoom, or click into the map first", { byClick: true });
    this.map.setView([0, 0], this.ground.options.minZoom);
    this.map.on("mousemove", (event) => {
      this.#readOut("pointer", event.latlng);
      this.frame.classList.toggle("on-finding", Boolean(this.#findingAt(event.layerPoint)));
    });
    this.map.on("click", (event) => {
      const found = this.#findingAt(event.layerPoint);
      if (found) this.#pick(found);
    });
    this.map.on("move", () => this.#readOutCentre());
    this.map.on("zoomend", () => {
      this.layers.forEach((layer) => layer.zoomed());
      this.#number();
      this.#arrange();
    });
    this.#readOut();
    for (const away of ["pointerleave", "blur"]) this.frame.addEventListener(away, () => this.#readOut());
    for (const touch of ["wheel", "keydown", "pointerdown"]) {
      this.frame.addEventListener(touch, () => (this.#moved = true), { passive: true });
    }
    new ResizeObserver(() => isOnScreen() && this.#resize() && !this.#moved && this.fit()).observe(this.frame);
    addEventListener("beforeprint", () => this.#keepSize());
  }

  // Paper gets the map as it is now, at another scale: once the paper's size is known nothing is drawn anew.
  #keepSize() {
    const { clientWidth, clientHeight } = this.element;
    const sizes = { width: `${clientWidth}px`, height: `${clientHeight}px`, scale: Math.min(1, PAPER_PX / clientWidth) };
    for (const [name, size] of Object.entries(sizes)) this.element.style.setProperty(`--${name}`, size);
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

  // Takes the size that the page gives it now; whether that is another one.
  #resize() {
    const before = this.map.getSize();
    return !this.map.invalidateSize({ animate: false }).getSize().equals(before);
  }

  fit() {
    const corners = this.#plans.filter(Boolean).flatMap((plan) => {
      const ranges = [...plan.ranges.values()].flatMap(([east, north, radius]) => {
        return [[east - radius, north - radius], [east + radius, north + radius]];
      });
      return [[0, 0], ...plan.waypoints_m, ...ranges, ...(this.#painted ? around(plan.waypoints_m, this.#painted) : [])].map(([east, north]) => this.ground.latLng(east, north, plan));
    });
    if (corners.length) this.map.fitBounds(L.latLngBounds(corners), { paddingTopLeft: [18, this.layers.length > 1 ? 56 : 18], paddingBottomRight: [18, 18], animate: false });
  }

  // Where the pointer is, or the middle of the map for those who move it by keyboard; else only whose tiles these are.
  #readOut(what = "", place = null) {
    const [east, north] = place ? this.ground.metres(place) : [];
    const there = place && `${what}: ${east.toFixed(0)} m east, ${north.toFixed(0)} m north of home`;
    const parts = [there, place && this.ground.degrees(east, north), this.ground.tiles?.credit];
    write(this.readout, parts.filter(Boolean).join(" · "));
  }

  #readOutCentre() {
    if (this.frame.matches(":focus-visible")) this.#readOut("centre of the map", this.map.getCenter());
  }

  #findingAt(point) {
    const found = this.layers.map((layer, index) => ({ layer, story: this.#stories[index], finding: layer.findingAt(point) }));
    return found.findLast(({ finding }) => finding) ?? null;
  }

  // A count of findings leads nearer to them, as long as the map can.
  #pick({ layer, story, finding }) {
    const group = this.#pills.groupOf(finding);
    if (group && this.map.getZoom() < this.ground.options.maxZoom) {
      this.#moved = true;
      layer.zoomTo(group);
    } else this.found(story, finding);
  }

  // Says where the number of each finding stands.
  #number() {
    const isShown = (index) => this.#only === null || index === this.#only;
    this.#pills.arrange(this.layers.map((layer, index) => layer.placed(isShown(index) ? (this.#stories[index]?.numbered ?? []) : [])));
    this.layers.forEach((layer) => layer.renumber(this.#current));
  }

  // Each flight at its moment, and the finding that is looked at: of the flight of the index `only`, or of all.
  show(moments, current, only = null) {
    const plans = moments.map((moment) => moment.story.shownPlan);
    const homes = moments.map((moment) => moment.story.home);
    const others = plans.some((plan, index) => plan !== this.#plans[index] || homes[index] !== this.#homes[index]);
    const painted = this.#painted;
    this.#painted = moments.map((moment) => moment.story.painted[0]).find(Boolean) ?? null;
    if (others || this.#stale) {
      [this.#plans, this.#homes, this.#stale] = [plans, homes, false];
      this.ground.settle(plans);
      this.#resize();
      this.#begin();
      if (others || !this.#moved) this.fit();
    } else if (!painted && this.#painted && !this.#moved) this.fit();
    moments.forEach((moment, index) => this.layers[index].show(moment));
    this.#showFindings(moments, current, only);
    if (moments.length > 1) this.#showUsers(moments);
    else this.#showStates(moments[0]);
    this.#arrange();
  }

  #showFindings(moments, current, only) {
    this.#stories = moments.map(({ story }) => story);
    const found = this.#stories.map((story) => story.found);
    const isNew = only !== this.#only || found.some((each, index) => each !== this.#found[index]);
    const isOther = current !== this.#current;
    [this.#found, this.#current, this.#only] = [found, current, only];
    if (isNew) this.#number();
    else if (isOther) this.layers.forEach((layer) => layer.refreshFindings(current));
  }

  // Moves the servers' labels out of each other's way, and of the drones' and the findings'.
  #arrange() {
    const labels = [...this.#servers.values()].map(({ chip, centre }) => [chip, this.map.latLngToLayerPoint(centre)]);
    const drones = this.layers.map((layer) => layer.point).filter(Boolean);
    const taken = drones.map(({ x, y }) => {
      return { x: x - DRONE_PX / 2, y: y - DRONE_PX / 2, width: DRONE_PX, height: DRONE_PX };
    });
    const near = ({ x, y }) => labels.some(([, place]) => Math.hypot(x - place.x, y - place.y) < LABEL_PX);
    this.#labels.arrange(labels, [...taken, ...this.#pills.boxes.filter(near)]);
  }

  // Draws at once what would be drawn at the next frame, which paper does not wait for.
  flush() {
    for (const renderer of [this.map._renderer, ...Object.values(this.map._paneRenderers)].filter(Boolean)) renderer._redraw();
  }

  // Everything is drawn anew when it is shown next, in other colours.
  restyle() {
    this.#stale = true;
  }

  focus(index) {
    this.layers.forEach((layer, each) => layer.focus(each === index));
  }

  #begin() {
    this.areas.clearLayers();
    this.#servers.clear();
    this.#labels.clear();
    this.ground.layer()?.addTo(this.areas);
    const homes = new Map();
    for (const [index, plan] of this.#plans.entries()) {
      if (!plan) continue;
      for (const [server, [east, north, radius]] of plan.ranges) {
        if (!this.#servers.has(server)) this.#drawRange(server, this.ground.latLng(east, north, plan), radius);
      }
      const told = this.#homes[index]; // by the vehicle; before that and where it tells none it is nobody's
      const home = told && this.ground.latLng(told.east_m, told.north_m, plan);
      if (home) homes.set(home.join(), home);
    }
    this.layers.forEach((layer, index) => layer.begin(this.#plans[index]));
    this.#found = []; // their places may be others
    for (const home of homes.values()) L.marker(home, { ...STILL, icon: homeIcon() }).addTo(this.areas);
  }

  #drawRange(server, centre, radius) {
    const color = this.places.colour(server);
    const dashArray = radius > DASHED_M ? null : this.places.dashes(server);
    const range = L.circle(centre, { ...STILL, ...ASIDE, color, dashArray, radius }).addTo(this.areas);
    const paint = (context, _, x, y) => paintCross(context, color, x, y);
    new Marks({ place: () => centre, paint, reach: 8, pane: "overlayPane" }).addTo(this.areas).show(1);
    const said = element("span");
    const chip = element("span", { class: "chip aside" }, this.places.icon(server), inBrief(server, NAME), " ", said);
    const icon = L.divIcon({ html: chip, className: "server", iconSize: null });
    L.marker(centre, { ...STILL, icon }).addTo(this.areas);
    this.#servers.set(server, { centre, range, chip, said, inUse: false });
  }

  // For the one drone that there is, the state of each server that it is busy with or leaves alone.
  #showStates(moment) {
    for (const [server, drawn] of this.#servers) {
      const step = moment.step(server);
      const told = step?.tone && step.tone !== "aside" ? step : null;
      write(drawn.said, told?.state ?? "");
      drawn.said.className = told ? `state ${told.tone}` : "";
      showUse(drawn, moment.using.includes(step));
    }
  }

  // Which drones use each server, or are about to.
  #showUsers(moments) {
    for (const [server, drawn] of this.#servers) {
      const users = moments.flatMap((moment, index) => {
        return moment.using.filter((used) => used.server === server).map(({ tone }) => ({ number: index + 1, tone }));
      });
      showUse(drawn, users.length > 0);
      const key = JSON.stringify(users);
      if (drawn.said.dataset.users === key) continue;
      drawn.said.dataset.users = key;
      drawn.said.className = "users";
      drawn.said.replaceChildren(...users.map(({ number, tone }) => badge(number, tone)));
    }
  }
}

// On paper the map stays as it was.
function isOnScreen() {
  return !document.documentElement.classList.contains("paper");
}

// A server that nobody uses is pale.
function showUse(drawn, inUse) {
  if (drawn.inUse === inUse) return;
  drawn.inUse = inUse;
  drawn.chip.classList.toggle("aside", !inUse);
  drawn.range.setStyle(inUse ? IN_USE : ASIDE);
}

// The corners of photos that are taken at the waypoints, by those of another one.
function around(waypoints, painted) {
  const [east, north] = [0, 1].map((axis) => (painted[0][axis] + painted[2][axis]) / 2);
  return waypoints.flatMap(([right, up]) => painted.map((corner) => [corner[0] - east + right, corner[1] - north + up]));
}
