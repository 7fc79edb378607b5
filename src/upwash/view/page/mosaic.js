// What each photo shows of the ground, painted as photos are taken: in the colour of the place that computed it, and the photo itself where the map is near.

import { Marks } from "./marks.js";
import { pictureOf } from "./pictures.js";

const NEAR_PX = 96; // on the map, from which on a photo itself is shown
const MOST_IMAGES = 48;
const [TINT, EDGE] = [0.3, 0.7];

export class Mosaic {
  #marks = null;
  #images = new Map(); // by shot, the last used at the end
  #places = new Map(); // by waypoint: where its call was computed
  #calls = 0;
  #open = new Set(); // the waypoints whose answers are not there
  #story = null;

  // Of the flight of that log; `latLng` and `scale` say where a place is on the map, and how many pixels a metre takes.
  constructor(map, places, log, { latLng, scale }) {
    Object.assign(this, { map, places, log, latLng, scale });
  }

  clear() {
    this.#marks?.remove();
    this.#marks = null;
    this.#images.clear();
    this.#calls = 0;
    this.#places.clear();
  }

  show(moment) {
    const { story } = moment;
    const count = moment.count("shot");
    this.#story = story;
    if (!this.#marks && !story.painted.length) return;
    this.#marks ??= new Marks({
      pane: "mosaic",
      place: (index) => this.latLng(...middleOf(story.shot[index].footprint_m)),
      paint: (context, index, x, y) => this.#paint(context, story.shot[index], x, y),
      reach: () => 2 * this.scale() * widthM(story.painted[0]),
    }).addTo(this.map);
    this.#open = new Set(moment.open.map(({ waypoint }) => waypoint));
    this.#marks.show(count);
    this.#showPlaces(story, count, moment.count("call"));
  }

  // Photos get the colours of the places that computed them by now.
  #showPlaces(story, count, calls) {
    if (calls === this.#calls) return;
    const changed = story.call.slice(Math.min(calls, this.#calls), Math.max(calls, this.#calls));
    this.#calls = calls;
    this.#places = new Map(story.call.slice(0, calls).map(({ waypoint, place }) => [waypoint, place]));
    const waypoints = new Set(changed.map(({ waypoint }) => waypoint));
    const first = story.shot.findIndex(({ waypoint }) => waypoints.has(waypoint));
    if (first >= 0 && first < count) this.#marks.redrawSome(first, count);
  }

  #paint(context, shot, x, y) {
    if (!shot.footprint_m) return;
    const scale = this.scale();
    const [east, north] = middleOf(shot.footprint_m);
    const corners = shot.footprint_m.map(([right, up]) => [x + scale * (right - east), y - scale * (up - north)]);
    const place = this.#places.get(shot.waypoint);
    const colour = place ? this.places.colour(place) : this.places.colours.of("soft");
    const image = scale * widthM(shot.footprint_m) >= NEAR_PX && this.#isInView(x, y) ? this.#image(shot) : null;
    const isOpen = !place && this.#open.has(shot.waypoint);
    context.setLineDash(isOpen ? [4, 4] : []);
    context.globalAlpha = 1;
    if (image) drawImage(context, image, corners);
    context.beginPath();
    for (const corner of corners) context.lineTo(...corner);
    context.closePath();
    context.fillStyle = context.strokeStyle = colour;
    context.lineWidth = image ? 2 : 1;
    context.globalAlpha = TINT;
    if (!image && !isOpen) context.fill();
    context.globalAlpha = EDGE;
    context.stroke();
    context.globalAlpha = 1;
  }

  #isInView(x, y) {
    const { x: width, y: height } = this.map.getSize();
    const { x: left, y: top } = this.map.layerPointToContainerPoint([x, y]);
    const margin = 2 * NEAR_PX;
    return left > -margin && left < width + margin && top > -margin && top < height + margin;
  }

  // The shot's picture, once it is loaded; of many the ones used least recently are let go.
  #image(shot) {
    const picture = pictureOf(this.log, this.#story.run, shot);
    if (!picture) return null;
    let image = this.#images.get(shot);
    this.#images.delete(shot);
    if (!image) {
      image = new Image();
      image.addEventListener("load", () => this.#marks?.redraw());
      image.src = picture.source;
    }
    this.#images.set(shot, image);
    if (this.#images.size > MOST_IMAGES) this.#images.delete(this.#images.keys().next().value);
    return image.complete && image.naturalWidth ? image : null;
  }
}

function drawImage(context, image, [[left, top], [right, up], , [low, down]]) {
  const { naturalWidth: width, naturalHeight: height } = image;
  context.save();
  context.transform((right - left) / width, (up - top) / width, (low - left) / height, (down - top) / height, left, top);
  context.drawImage(image, 0, 0);
  context.restore();
}

function middleOf(corners) {
  if (!corners) return [0, 0];
  return [0, 1].map((axis) => corners.reduce((sum, corner) => sum + corner[axis], 0) / corners.length);
}

function widthM([[east, north], [otherEast, otherNorth]]) {
  return Math.hypot(otherEast - east, otherNorth - north);
}
