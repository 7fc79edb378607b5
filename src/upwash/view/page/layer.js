// One flight on the map: its plan, the way flown, its calls and findings, the drone, and the line to the server that it uses.

import * as L from "./leaflet/leaflet-src.esm.js";
import { styleOf } from "./badge.js";
import { droneIcon, turn } from "./icons.js";
import { Mosaic } from "./mosaic.js";
import { Marks, STILL, paintFinding, paintMeasured, paintOpen, paintTurn } from "./marks.js";
import { Track } from "./track.js";
import { Waypoints } from "./waypoints.js";

const [STACKED, IN_A_ROW] = [1.8, 5]; // several calls at one place stand beside each other, so many radii apart
const ABOVE_ALL = 1000; // of the drone's mark; that of the drone in focus is above the others'
const [LEAST_PX, MOST_PX, RIM_PX] = [2.5, 5, 1]; // of a mark's radius; and around it
const PADDING_PX = 60; // around findings that are looked at closely
const REACH_PX = 110; // of a mark from its place, beside others

export class FlightLayer {
  #marks = {}; // by kind of fact
  #legM = 0; // as long is the plan's middle leg
  #radius = MOST_PX;
  #atS = 0; // the moment that is shown
  #aside = []; // by call: how many stand before it at the same place

  // Of the drone of that `number`; the only one there is has none.
  constructor(map, ground, places, pills, { log, number = null, chosen = null }) {
    this.map = map;
    this.ground = ground;
    this.places = places;
    this.pills = pills;
    this.current = null; // the finding that is looked at
    this.number = number;
    this.isFocus = false;
    this.plan = null;
    this.waypoints = new Waypoints(map, (box) => pills.leaves(box));
    const latLng = (east, north) => this.latLng(east, north);
    this.track = new Track(map, { latLng }, () => this.#line(0.35), () => this.#line(1));
    this.mosaic = new Mosaic(map, places, log, { latLng, scale: () => this.#scale });
    this.marks = L.layerGroup().addTo(map);
    const still = chosen ? { keyboard: false } : STILL;
    this.drone = L.marker([0, 0], { ...still, icon: droneIcon(number), zIndexOffset: ABOVE_ALL });
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
    this.mosaic.clear();
    this.marks.clearLayers();
    this.#marks = {};
    this.#aside = [];
    this.link?.remove();
    this.link = null;
    const { colours } = this.places;
    const [soft, ink, paper] = ["soft", "ink", "paper"].map((name) => colours.of(name));
    const line = this.number === null ? soft : this.#colour;
    this.waypoints.begin(plan, (east, north) => this.latLng(east, north), { line, soft, ink, paper });
    this.#legM = plan ? middleLegM(plan.waypoints_m) : 0;
    this.zoomed();
  }

  // How many pixels of the map a metre takes.
  get #scale() {
    const [here, there] = [0, 100].map((east) => this.map.latLngToLayerPoint(this.latLng(east, 0)));
    return here.distanceTo(there) / 100;
  }

  focus(isFocus) {
    this.drone.setZIndexOffset(isFocus ? 2 * ABOVE_ALL : ABOVE_ALL);
    this.drone.getElement()?.classList.toggle("focus", isFocus);
    if (this.isFocus === isFocus) return;
    this.isFocus = isFocus;
    this.#showNumbers();
  }

  show(moment) {
    const { position } = moment;
    this.#atS = moment.atS;
    this.mosaic.show(moment);
    this.track.show(moment.story.fix, moment.count("fix"), position, moment.atS);
    const paper = this.places.colours.of("paper");
    this.#showMarks(moment, "measured", ({ server, answered }, _, context, x, y) => {
      paintMeasured(context, this.places.colour(server), paper, answered, x, y);
    });
    this.#showMarks(moment, "open", ({ until_s }, _, context, x, y) => {
      if (until_s > this.#atS) paintOpen(context, this.places.colours.of("ink"), x, y, this.#radius + 1);
    });
    this.#showMarks(moment, "call", (call, index, context, x, y) => {
      const [right, down] = [this.#aside[index] % IN_A_ROW, Math.floor(this.#aside[index] / IN_A_ROW)];
      const step = STACKED * this.#radius;
      this.places.paint(context, call, x + step * right, y + step * down, this.#radius, RIM_PX);
    });
    this.#showMarks(moment, "turn", (_, __, context, x, y) => paintTurn(context, this.#colour, x, y));
    this.#showMarks(moment, "told", (finding, _, context, x, y) => this.#paintFinding(finding, context, x, y));
    this.#showLink(moment, position);
    this.#showDetour(moment, position);
    if (!position) {
      this.drone.remove();
      return;
    }
    this.drone.setLatLng(this.latLng(position.east_m, position.north_m)).addTo(this.map);
    turn(this.drone.getElement(), moment.headingDeg);
    this.drone.getElement().dataset.tone = moment.last("doing")?.tone ?? "";
    this.focus(this.isFocus);
  }

  // Marks are smaller where the waypoints are close to each other, and these have numbers where there is room.
  zoomed() {
    const room = 0.45 * this.#legM * this.#scale;
    this.#radius = room ? Math.min(MOST_PX, Math.max(LEAST_PX, room)) : MOST_PX;
    this.#showNumbers();
  }

  // Of several drones those of the one in focus.
  #showNumbers() {
    const wanted = (this.number === null || this.isFocus) && !this.pills.areDense;
    this.waypoints.showNumbers(wanted, this.#scale);
  }

  // Where the drone's mark is on the map's layers, in pixels; null where it has none.
  get point() {
    return this.map.hasLayer(this.drone) ? this.map.latLngToLayerPoint(this.drone.getLatLng()) : null;
  }

  get #colour() {
    return this.places.colours.of(this.number === null ? "ink" : styleOf(this.number));
  }

  #paintFinding(finding, context, x, y) {
    const isCurrent = finding === this.current;
    const colours = ["ink", "paper"].map((name) => this.places.colours.of(name));
    for (const sign of this.pills.signsOf(finding, isCurrent, this.#atS)) paintFinding(context, colours, sign, x, y);
  }

  // The numbers of what was found stand elsewhere, which leave the waypoints' more or less room.
  renumber(current) {
    this.#showNumbers();
    this.waypoints.redraw();
    this.refreshFindings(current);
  }

  // Draws the numbers of what was found anew.
  refreshFindings(current) {
    this.current = current;
    const { told } = this.#marks;
    if (told?.count) told.redrawSome(0, told.count);
  }

  // The finding that is drawn at that point of the map's layers, if any.
  findingAt(point) {
    const { told } = this.#marks;
    if (!told) return null;
    const at = (finding) => this.pills.isAt(finding, this.map.latLngToLayerPoint(this.#placeOf(finding)), point, this.#atS);
    return told.facts.slice(0, told.count).findLast(at) ?? null;
  }

  // [finding, point] pairs of what was found.
  placed(findings) {
    return findings.map((finding) => [finding, this.map.latLngToLayerPoint(this.#placeOf(finding))]);
  }

  // All of them into sight.
  zoomTo(findings) {
    const places = findings.map((finding) => this.#placeOf(finding));
    this.map.fitBounds(L.latLngBounds(places), { padding: [PADDING_PX, PADDING_PX] });
  }

  #placeOf({ east_m, north_m }) {
    return this.latLng(east_m, north_m);
  }

  #line(opacity) {
    return { color: this.#colour, border: this.places.colours.of("paper"), weight: 2, opacity, ...STILL };
  }

  // On a detour, the way back that is left.
  #showDetour(moment, position) {
    const turn = moment.last("beside")?.kind === "detour" && !moment.isOver ? moment.last("turn") : null;
    const place = turn && this.plan?.waypoints_m[turn.waypoint];
    this.detour ??= L.polyline([], { ...STILL, weight: 9, opacity: 0.35 }).addTo(this.map);
    this.detour.setStyle({ color: this.#colour });
    this.detour.setLatLngs(place && position ? [this.latLng(position.east_m, position.north_m), this.latLng(...place)] : []);
  }

  // From the drone to the server that it uses; dashed while that is being checked.
  #showLink(moment, position) {
    const [used] = moment.using;
    const range = used && this.plan?.ranges.get(used.server);
    if (!range || !position) {
      this.link?.remove();
      this.link = null;
      return;
    }
    const color = this.number === null ? this.places.colour(used.server) : this.#colour;
    const dashArray = used.tone === "ready" ? null : "3 6";
    this.link ??= L.polyline([], { ...STILL, weight: 2.5 }).addTo(this.map);
    const { options } = this.link;
    if (options.color !== color || options.dashArray !== dashArray) this.link.setStyle({ color, dashArray });
    this.link.setLatLngs([this.latLng(position.east_m, position.north_m), this.latLng(range[0], range[1])]);
  }

  // Those facts of the kind that lie before the moment, each where the drone was.
  #showMarks(moment, kind, painted) {
    const facts = moment.story[kind];
    const count = moment.count(kind);
    if (!count && !this.#marks[kind]) return;
    this.#marks[kind] ??= new Marks({
      place: (index) => {
        const { east_m, north_m } = facts[index];
        if (kind === "call") this.#aside.push(isThere(facts, index) ? this.#aside[index - 1] + 1 : 0);
        return this.latLng(east_m ?? 0, north_m ?? 0);
      },
      paint: (context, index, x, y) => painted(facts[index], index, context, x, y),
      reach: REACH_PX,
      facts,
    }).addTo(this.marks);
    this.#marks[kind].show(count);
  }
}

function middleLegM(way) {
  const legs = way.slice(1).map(([east, north], index) => Math.hypot(east - way[index][0], north - way[index][1]));
  return legs.sort((one, other) => one - other)[legs.length >> 1] ?? 0;
}

// Whether it is where the one before it is.
function isThere(facts, index) {
  const [before, here] = [facts[index - 1], facts[index]];
  return index > 0 && before.east_m === here.east_m && before.north_m === here.north_m;
}
