// The delay of each call by waypoint, growing as calls come; what was waited is broad, with a ring around the mark.

import { counted, element, write } from "./element.js";
import { theNameOf } from "./places.js";

const [LEFT, RIGHT, TOP, BOTTOM] = [44, 12, 22, 40];
const HEIGHT = 250;

export class DelayChart {
  #drawn = 0; // calls
  #scale = "";
  #pointed = null;
  #over = ""; // what is drawn over the marks

  constructor(name, places, picked) {
    this.name = name;
    this.places = places;
    this.marks = element("canvas", { role: "img" });
    this.over = element("canvas", { class: "over", "aria-hidden": "true" });
    this.tip = element("p", { class: "tip", hidden: "" });
    this.element = element("div", { class: "chart" }, this.marks, this.over, this.tip);
    this.over.addEventListener("pointermove", (event) => this.#point(event));
    this.over.addEventListener("pointerleave", () => this.#pointAt(null));
    this.over.addEventListener("click", () => this.#pointed && picked(this.#pointed));
    new ResizeObserver(() => this.restyle()).observe(this.element);
  }

  restyle() {
    this.#scale = "";
    if (this.moment) this.show(this.moment, this.limits);
  }

  // Forgets what is drawn, for calls of another run.
  clear() {
    this.#scale = "";
  }

  // The calls until the moment, on scales that hold `limits`.
  show(moment, limits) {
    this.moment = moment;
    this.limits = limits;
    const count = moment.count("call");
    const width = this.element.clientWidth;
    const scale = [width, devicePixelRatio, limits.waypoints, limits.longestS, limits.before].join();
    if (scale !== this.#scale) this.#begin(width, scale);
    const context = this.marks.getContext("2d");
    const calls = moment.story.call;
    if (count < this.#drawn) this.#takeBack(context, calls, count);
    while (this.#drawn < count) this.#draw(context, calls[this.#drawn++]);
    this.#drawOver(calls[count - 1]);
    const words = `Chart of call delays, ${this.name}. ${inWords(count, moment.delays)}`;
    if (words !== this.marks.getAttribute("aria-label")) this.marks.setAttribute("aria-label", words);
  }

  #begin(width, scale) {
    this.#scale = scale;
    this.#over = "";
    this.#drawn = 0;
    this.width = width;
    for (const canvas of [this.marks, this.over]) {
      canvas.width = Math.round(width * devicePixelRatio);
      canvas.height = Math.round(HEIGHT * devicePixelRatio);
      canvas.getContext("2d").setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    }
    this.#drawAxes(this.marks.getContext("2d"));
  }

  // All calls but the first so many; nothing is drawn anew but the part of the chart where they are.
  #takeBack(context, calls, count) {
    const reach = Math.ceil(this.#radius) + 5;
    let [left, right] = [this.width, 0];
    for (const call of calls.slice(count, this.#drawn)) {
      const [x] = this.#place(call);
      [left, right] = [Math.min(left, Math.floor(x) - reach), Math.max(right, Math.ceil(x) + reach)];
    }
    context.save();
    context.beginPath();
    context.rect(left, 0, right - left, HEIGHT);
    context.clip();
    context.clearRect(left, 0, right - left, HEIGHT);
    this.#drawAxes(context);
    for (const call of calls.slice(0, count)) {
      const [x] = this.#place(call);
      if (x > left - reach && x < right + reach) this.#draw(context, call);
    }
    context.restore();
    this.#drawn = count;
  }

  #x(waypoint) {
    const [first, last] = [this.limits.before ? -1.5 : -0.5, Math.max(1, this.limits.waypoints) - 0.5];
    return LEFT + ((waypoint - first) / (last - first)) * (this.width - LEFT - RIGHT);
  }

  #y(seconds) {
    return HEIGHT - BOTTOM - (seconds / (this.limits.longestS * 1.08)) * (HEIGHT - BOTTOM - TOP);
  }

  #place(call) {
    return [this.#x(call.waypoint ?? -1) + this.#aside(call.operation), this.#y(call.delay_s)];
  }

  // Calls of several operations at a waypoint stand beside each other, where there is room.
  #aside(operation) {
    const { operations } = this.places;
    const room = this.#x(1) - this.#x(0);
    const step = 2 * this.#radius + 4;
    return room < operations.length * step ? 0 : (operations.indexOf(operation) - (operations.length - 1) / 2) * step;
  }

  get #radius() {
    return Math.min(4.5, Math.max(2, (this.width - LEFT - RIGHT) / 2 / Math.max(1, this.limits.waypoints)));
  }

  #drawAxes(context) {
    const { colours } = this.places;
    context.font = "12px system-ui, sans-serif";
    context.lineWidth = 1;
    context.strokeStyle = colours.of("line");
    context.fillStyle = colours.of("soft");
    context.textAlign = "right";
    for (const value of ticks(0, this.limits.longestS, 5)) {
      const y = Math.round(this.#y(value)) + 0.5;
      line(context, LEFT, y, this.width - RIGHT, y);
      context.fillText(String(+value.toFixed(3)), LEFT - 7, y + 4);
    }
    context.textAlign = "center";
    for (const value of ticks(0, this.limits.waypoints - 1, this.width / 70, 1)) {
      context.fillText(String(value), this.#x(value), HEIGHT - BOTTOM + 17);
    }
    context.fillStyle = colours.of("ink");
    context.fillText("waypoint", (LEFT + this.width - RIGHT) / 2, HEIGHT - 6);
    context.textAlign = "left";
    context.fillText("call delay (s)", 4, 12);
  }

  #draw(context, call) {
    const { colours } = this.places;
    const [x, y] = this.#place(call);
    const colour = this.places.colour(call.place);
    context.strokeStyle = colour;
    context.globalAlpha = 0.6;
    context.lineWidth = 1.2;
    line(context, x, this.#y(0), x, y);
    context.globalAlpha = 1;
    if (call.wait) {
      context.strokeStyle = colours.of("ink");
      context.lineWidth = 3;
      line(context, x, this.#y(0), x, this.#y(call.waited_s));
      context.lineWidth = 1.4;
      context.beginPath();
      context.arc(x, y, this.#radius + 3, 0, 2 * Math.PI);
      context.stroke();
    }
    this.places.paint(context, call, x, y, this.#radius);
  }

  #drawOver(last) {
    const call = this.#pointed ?? last;
    const what = [this.#scale, this.#drawn, call?.at_s].join();
    if (what === this.#over) return;
    this.#over = what;
    const context = this.over.getContext("2d");
    context.clearRect(0, 0, this.width, HEIGHT);
    context.strokeStyle = this.places.colours.of("place-0");
    context.lineWidth = 1.5;
    context.setLineDash([6, 4]);
    for (const { mean } of this.moment.localDelays.values()) {
      line(context, LEFT, this.#y(mean), this.width - RIGHT, this.#y(mean));
    }
    context.setLineDash([]);
    if (!call) return;
    const [x, y] = this.#place(call);
    context.strokeStyle = this.places.colours.of("ink");
    context.strokeRect(x - this.#radius - 6, y - this.#radius - 6, 2 * this.#radius + 12, 2 * this.#radius + 12);
  }

  #point(event) {
    const calls = this.moment.story.call.slice(0, this.#drawn);
    const away = (call) => {
      const [x, y] = this.#place(call);
      return Math.abs(x - event.offsetX) + Math.abs(y - event.offsetY) / 8;
    };
    const nearest = calls.reduce((best, call) => (best === null || away(call) < away(best) ? call : best), null);
    this.#pointAt(nearest && away(nearest) < 40 ? nearest : null);
  }

  #pointAt(call) {
    this.#pointed = call;
    this.tip.hidden = !call;
    if (call) {
      write(this.tip, inShort(call));
      const [x] = this.#place(call);
      this.tip.style.left = `${Math.min(Math.max(x, 90), Math.max(90, this.width - 90))}px`;
    }
    this.#drawOver(this.moment.story.call[this.#drawn - 1]);
  }
}

function inWords(count, delays) {
  const words = [...delays].map(([place, { number, mean }]) => {
    return `${number} on ${theNameOf(place)}, ${mean.toFixed(2)} s on average`;
  });
  return `${counted(count, "call")}${words.length ? ": " + words.join("; ") : ""}. The table of calls has all of them.`;
}

export function inShort(call) {
  const where = call.waypoint === null ? "before the first waypoint" : `waypoint ${call.waypoint}`;
  const waited = call.wait ? `, ${call.waited_s.toFixed(2)} s of it waited` : "";
  const inLine = call.queued_s ? `, ${call.queued_s.toFixed(2)} s of it in line` : "";
  return `${where}: ${call.operation} on ${theNameOf(call.place)}, ${call.delay_s.toFixed(2)} s${waited}${inLine}`;
}

export function line(context, fromX, fromY, toX, toY) {
  context.beginPath();
  context.moveTo(fromX, fromY);
  context.lineTo(toX, toY);
  context.stroke();
}

// Round values from `first` to `last`.
function ticks(first, last, atMost, least = 0) {
  const span = Math.max(last - first, 1e-9) / Math.max(1, atMost);
  const power = 10 ** Math.floor(Math.log10(span));
  const step = Math.max(least, [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= span * 0.999));
  const values = [];
  for (let value = first; value <= last + 1e-9; value += step) values.push(value);
  return values;
}
