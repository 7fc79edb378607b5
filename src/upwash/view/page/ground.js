// Where places are on the map: on a plane in metres, or on the Earth where tiles are to lie beneath.

import * as L from "./leaflet/leaflet-src.esm.js";

const PLANE = { crs: L.CRS.Simple, minZoom: -6, maxZoom: 6 };
const EARTH = { crs: L.CRS.EPSG3857, minZoom: 1, maxZoom: 23 };
const NOTHING = "data:image/gif;base64,R0lGODlhAQABAAAAACH5BAEKAAEALAAAAAABAAEAAAICTAEAOw==";
const NOWHERE = { home: [0, 0], metres_per_degree: [111319, 110574] }; // a log may not know where home is

export class Ground {
  #origin = NOWHERE;

  constructor(tiles) {
    this.tiles = tiles;
    this.options = { ...(tiles ? EARTH : PLANE), zoomSnap: tiles ? 1 : 0.25, zoomDelta: tiles ? 1 : 0.5 };
  }

  // Whose home is the middle of everything from now on: that of the first plan which knows where it is.
  settle(plans) {
    this.#origin = plans.find((plan) => plan?.home) ?? NOWHERE;
  }

  // Of a place that is so far from the plan's home.
  latLng(east, north, plan) {
    const [right, up] = this.#away(plan);
    return this.tiles ? onEarth(this.#origin, east + right, north + up) : [north + up, east + right];
  }

  // East and north of the home in the middle.
  metres(latLng) {
    if (!this.tiles) return [latLng.lng, latLng.lat];
    const { home, metres_per_degree } = this.#origin;
    return [(latLng.lng - home[1]) * metres_per_degree[0], (latLng.lat - home[0]) * metres_per_degree[1]];
  }

  // In degrees, of a place so far from the home in the middle; or nothing where that is not known.
  degrees(east, north) {
    return degrees(this.#origin === NOWHERE ? null : this.#origin, east, north);
  }

  // What lies beneath, where it is wanted and known.
  layer() {
    if (!this.tiles || this.#origin === NOWHERE) return null;
    const { url, from_zoom = 0, to_zoom = 19 } = this.tiles;
    // Farther out, Leaflet would ask for very many tiles of the least zoom.
    const zooms = { minZoom: from_zoom - 2, maxZoom: EARTH.maxZoom, minNativeZoom: from_zoom, maxNativeZoom: to_zoom };
    return url ? L.tileLayer(url, { ...zooms, referrerPolicy: "strict-origin" }) : new Inlined("", zooms);
  }

  // How far the plan's home is from the one in the middle.
  #away(plan) {
    if (!plan?.home || plan === this.#origin) return [0, 0];
    const { home, metres_per_degree } = this.#origin;
    return [(plan.home[1] - home[1]) * metres_per_degree[0], (plan.home[0] - home[0]) * metres_per_degree[1]];
  }
}

// Tiles that are in the document, by "z/x/y"; elsewhere there is nothing.
class Inlined extends L.TileLayer {
  #tiles = JSON.parse(document.getElementById("tiles")?.textContent ?? "{}");

  getTileUrl({ z, x, y }) {
    return this.#tiles[`${z}/${x}/${y}`] ?? NOTHING;
  }
}

// A place so far from the plan's home in degrees, or nothing where that home is not known.
export function degrees(plan, east, north) {
  if (!plan?.home) return "";
  return onEarth(plan, east, north).map((each) => `${each.toFixed(6)}°`).join(", ");
}

function onEarth({ home, metres_per_degree }, east, north) {
  return [home[0] + north / metres_per_degree[1], home[1] + east / metres_per_degree[0]];
}
