// Where places are on the map: on a plane in metres, or on the Earth where tiles are to lie beneath.

import * as L from "./leaflet/leaflet-src.esm.js";

const PLANE = { crs: L.CRS.Simple, minZoom: -6, maxZoom: 6 };
const EARTH = { crs: L.CRS.EPSG3857, minZoom: 1, maxZoom: 23 };
const NOWHERE = { home: [0, 0], metres_per_degree: [111319, 110574] }; // a log may not know where home is

export class Ground {
  #origin = NOWHERE;

  constructor(tiles) {
    this.tiles = tiles;
    this.options = { ...(tiles ? EARTH : PLANE), zoomSnap: tiles ? 1 : 0.25, zoomDelta: tiles ? 1 : 0.5 };
  }

  // Where home is, from now on.
  settle(plan) {
    this.#origin = plan?.home ? plan : NOWHERE;
  }

  latLng(east, north) {
    return this.tiles ? this.#onEarth(east, north) : [north, east];
  }

  metres(latLng) {
    if (!this.tiles) return [latLng.lng, latLng.lat];
    const { home, metres_per_degree } = this.#origin;
    return [(latLng.lng - home[1]) * metres_per_degree[0], (latLng.lat - home[0]) * metres_per_degree[1]];
  }

  // In degrees, or nothing where they are not known.
  degrees(east, north) {
    if (this.#origin === NOWHERE) return "";
    return this.#onEarth(east, north).map((degrees) => `${degrees.toFixed(6)}°`).join(", ");
  }

  // What lies beneath, where it is wanted and known.
  layer() {
    if (!this.tiles || this.#origin === NOWHERE) return null;
    const { maxZoom } = EARTH;
    return L.tileLayer(this.tiles.url, { maxZoom, maxNativeZoom: 19, referrerPolicy: "strict-origin" });
  }

  #onEarth(east, north) {
    const { home, metres_per_degree } = this.#origin;
    return [home[0] + north / metres_per_degree[1], home[1] + east / metres_per_degree[0]];
  }
}
