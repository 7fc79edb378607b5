// The flight over time: a lane for the calls, one for each server, and for alarms, battery and link. A click goes to that moment.

import { inShort, line } from "./chart.js";
import { told } from "./clock.js";
import { card, counted, element, write } from "./element.js";
import { inBrief } from "./places.js";
import { guardWheel } from "./wheel.js";

const [LEFT, RIGHT, AXIS] = [88, 12, 20];
const [LANE, BAR] = [18, 12];
const MARK = 4; // the radius of a place's mark: beside a server's name, and on a call that is long enough
const STATES = { ready: "ready", checking: "check", trouble: "listed" }; // the colours of a server's states, by tone
const TOLD = { aside: "pale: in range", checking: "checked", ready: "ready", trouble: "left alone" }; // in their colours
const BESIDE = { detour: "on a detour to act on answers", wait: "waiting for answers" };
const NEAR_PX = 6; // of a call, to be pointed at
const ZOOM = 1.25; // with each step of a wheel
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400]; // between numbers on the axis
const SHORTEST_S = 5; // that fills all of it

export class Lanes {
  #drawn = ""; // what the lanes show
  #range = null; // the seconds from and to, where a person has zoomed
  #within = new Map(); // by server: when the drone was in its range, as far as the fixes were looked at
  #moment = null;

  constructor(name, places, seek) {
    this.places = places;
    this.seek = seek;
    this.canvas = element("canvas", { role: "img", "aria-label": `Servers, calls and alarms over time, ${name}` });
    this.over = element("canvas", { class: "over", "aria-hidden": "true" });
    this.tip = element("p", { class: "tip", hidden: "" });
    this.frame = element("div", { class: "lanes" }, this.canvas, this.over, this.tip);
    const states = Object.entries(TOLD).map(([tone, words]) => element("span", { class: `state ${tone}` }, words));
    this.element = card("Flight over time", element("p", { class: "legend" }, ...states), this.frame);
    this.element.classList.add("over-time");
    this.over.addEventListener("pointermove", (event) => this.#point(event.offsetX, event.offsetY));
    this.over.addEventListener("pointerleave", () => (this.tip.hidden = true));
    this.over.addEventListener("click", (event) => this.seek(this.#second(event.offsetX)));
    this.over.addEventListener("wheel", (event) => this.#zoom(event), { passive: false });
    guardWheel(this.frame, "Turn the wheel with Ctrl to zoom");
    this.over.addEventListener("dblclick", () => this.#showRange(null));
    new ResizeObserver(() => this.#moment && this.show(this.#moment)).observe(this.frame);
  }

  // Draws anew what is shown next: the log has begun another run, or the colours are others.
  clear() {
    this.#drawn = "";
    this.#within.clear();
  }

  show(moment) {
    this.#moment = moment;
    const { story } = moment;
    const lanes = lanesOf(story);
    const what = [this.frame.clientWidth, devicePixelRatio, story.run, story.facts, lanes.length, this.#range].join();
    if (what !== this.#drawn) this.#draw(what, lanes);
    this.#drawMoment();
  }

  get #span() {
    const { story } = this.#moment;
    return this.#range ?? [0, Math.max(1, story.clockS(story.endsS))];
  }

  #x(second) {
    const [from, to] = this.#span;
    return LEFT + ((second - from) / (to - from)) * (this.width - LEFT - RIGHT);
  }

  #second(x) {
    const [from, to] = this.#span;
    return Math.min(to, Math.max(from, from + ((x - LEFT) / (this.width - LEFT - RIGHT)) * (to - from)));
  }

  #zoom(event) {
    event.preventDefault();
    const { story } = this.#moment;
    const endS = story.clockS(story.endsS);
    const [from, to] = this.#span;
    const [here, factor] = [this.#second(event.offsetX), event.deltaY > 0 ? ZOOM : 1 / ZOOM];
    const length = Math.max(SHORTEST_S, (to - from) * factor);
    const start = Math.min(Math.max(0, here - ((here - from) / (to - from)) * length), endS - length);
    this.#showRange(length < endS ? [start, start + length] : null);
  }

  #showRange(range) {
    this.#range = range;
    this.show(this.#moment);
  }

  #draw(what, lanes) {
    this.#drawn = what;
    this.lanes = lanes;
    this.width = this.frame.clientWidth;
    this.height = LANE * lanes.length + AXIS;
    this.frame.style.height = `${this.height}px`;
    for (const canvas of [this.canvas, this.over]) {
      canvas.width = Math.round(this.width * devicePixelRatio);
      canvas.height = Math.round(this.height * devicePixelRatio);
      canvas.getContext("2d").setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    }
    const context = this.canvas.getContext("2d");
    context.font = "12px system-ui, sans-serif";
    this.#drawAxis(context);
    lanes.forEach(({ kind, name }, lane) => this.#drawName(context, kind, name, LANE * lane + LANE / 2));
    context.save();
    context.beginPath();
    context.rect(LEFT, 0, this.width - LEFT - RIGHT, this.height - AXIS);
    context.clip();
    lanes.forEach(({ kind, name }, lane) => this.#drawLane(context, kind, name, LANE * lane + (LANE - BAR) / 2));
    context.restore();
  }

  #drawAxis(context) {
    const { colours } = this.places;
    const [from, to] = this.#span;
    context.strokeStyle = colours.of("line");
    context.fillStyle = colours.of("soft");
    context.lineWidth = 1;
    context.textAlign = "center";
    const least = (90 * (to - from)) / this.width;
    const longest = STEPS_S.at(-1);
    const step = STEPS_S.find((each) => each >= least) ?? longest * Math.ceil(least / longest);
    for (let second = Math.ceil(from / step) * step; second <= to; second += step) {
      const x = Math.round(this.#x(second)) + 0.5;
      line(context, x, 0, x, this.height - AXIS);
      context.fillText(told(second), x, this.height - 5);
    }
  }

  #drawName(context, kind, name, middle) {
    const right = LEFT - (kind === "server" ? 8 + 3 * MARK : 8);
    context.fillStyle = this.places.colours.of("ink");
    context.textAlign = "right";
    let most = Math.min(name.length, LEFT); // no letter is narrower than a pixel
    while (most > 3 && context.measureText(inBrief(name, most)).width > right) most -= 1;
    context.fillText(inBrief(name, most), right, middle + 4, right);
    if (kind === "server") this.places.paint(context, { place: name }, LEFT - 8 - MARK, middle, MARK);
  }

  #drawLane(context, kind, name, top) {
    const { story } = this.#moment;
    const { colours } = this.places;
    const bar = (fromS, toS, colour, alpha = 1, share = 1) => {
      context.globalAlpha = alpha;
      context.fillStyle = colour;
      const left = this.#x(story.clockS(fromS));
      context.fillRect(left, top + BAR * (1 - share), Math.max(1, this.#x(story.clockS(toS)) - left), BAR * share);
      context.globalAlpha = 1;
    };
    switch (kind) {
      case "calls":
        for (const call of story.call) {
          const fromS = beganS(call);
          bar(fromS, call.at_s, this.places.colour(call.place), 0.85);
          if (call.wait) bar(fromS, Math.min(call.at_s, fromS + call.waited_s), colours.of("ink"), 0.5);
          const [left, right] = [fromS, call.at_s].map((atS) => this.#x(story.clockS(atS)));
          if (right - left > 4 * MARK) this.places.paint(context, { place: call.place }, (left + right) / 2, top + BAR / 2, MARK, 1);
        }
        break;
      case "server":
        for (const [fromS, toS] of this.#inRange(story, name)) bar(fromS, toS, this.places.colour(name), 0.15);
        for (const [step, toS] of stretches(story.steps.get(name) ?? [], story.endsS)) {
          if (STATES[step.tone]) bar(step.at_s, toS, colours.of(STATES[step.tone]));
        }
        break;
      case "open": {
        const steps = openOver(story);
        const most = Math.max(...steps.map(({ number }) => number));
        for (const [{ at_s, number }, toS] of stretches(steps, story.endsS)) bar(at_s, toS, colours.of("soft"), 0.7, number / most);
        break;
      }
      case "detours":
        for (const [{ at_s, kind: what }, toS] of stretches(story.beside, story.endsS)) {
          if (what) bar(at_s, toS, colours.of(what === "wait" ? "check" : "ink"), 0.7);
        }
        break;
      case "alarms":
        for (const [notice, toS] of held(story)) bar(notice.at_s, toS, colours.of(notice.level === "alarm" ? "alarm" : "check"));
        break;
      default:
        this.#drawCurve(context, CURVES[kind](story), top);
    }
  }

  #drawCurve(context, { facts, value, most }, top) {
    context.strokeStyle = this.places.colours.of("ink");
    context.lineWidth = 1.4;
    context.beginPath();
    let last = -Infinity;
    for (const fact of facts) {
      const x = this.#x(this.#moment.story.clockS(fact.at_s));
      if (x - last < 1) continue;
      last = x;
      context.lineTo(x, top + BAR * (1 - value(fact) / most));
    }
    context.stroke();
  }

  // From when to when the drone was in the server's range, in seconds of the log.
  #inRange(story, server) {
    const range = story.plan?.ranges.get(server);
    if (!range) return [];
    const known = this.#within.get(server) ?? { seen: 0, found: [], since: null };
    this.#within.set(server, known);
    const [east, north, radius] = range;
    for (; known.seen < story.fix.length; known.seen += 1) {
      const fix = story.fix[known.seen];
      const inside = Math.hypot(fix.east_m - east, fix.north_m - north) <= radius;
      if (inside) known.since ??= fix.at_s;
      else if (known.since !== null) {
        known.found.push([known.since, fix.at_s]);
        known.since = null;
      }
    }
    return known.since === null ? known.found : [...known.found, [known.since, story.endsS]];
  }

  #drawMoment() {
    const context = this.over.getContext("2d");
    context.clearRect(0, 0, this.width, this.height);
    const x = this.#x(this.#moment.story.clockS(this.#moment.atS));
    if (x < LEFT - 1 || x > this.width - RIGHT + 1) return;
    context.strokeStyle = this.places.colours.of("ink");
    context.lineWidth = 2;
    line(context, x, 0, x, this.height - AXIS);
  }

  #point(x, y) {
    const lane = this.lanes?.[Math.floor(y / LANE)];
    const words = lane && x >= LEFT ? this.#words(lane, this.#second(x), x) : "";
    this.tip.hidden = !words;
    write(this.tip, words);
    this.tip.style.left = `${Math.min(Math.max(x, 120), Math.max(120, this.width - 120))}px`;
  }

  #words({ kind, name }, second, x) {
    const { story } = this.#moment;
    const there = story.at(second);
    const at = `${told(second)} `;
    if (kind === "calls") {
      const call = story.call.find((each) => {
        const [left, right] = [beganS(each), each.at_s].map((atS) => this.#x(story.clockS(atS)));
        return x > left - NEAR_PX && x < right + NEAR_PX;
      });
      return call ? at + inShort(call) : "";
    }
    if (kind === "open") {
      const { open } = there;
      const which = open.length ? `: ${open.length === 1 ? "waypoint" : "waypoints"} ${open.map(({ waypoint }) => waypoint).join(", ")}` : "";
      return `${at}${counted(open.length, "open answer")}${which}`;
    }
    if (kind === "detours") {
      const words = BESIDE[there.last("beside")?.kind];
      return words ? at + words : "";
    }
    if (kind === "server") {
      const step = there.step(name);
      const inside = this.#inRange(story, name).some(([fromS, toS]) => there.atS >= fromS && there.atS <= toS);
      const state = step ? [step.means, step.why].filter(Boolean).join(": ") : "available";
      return `${at}${name}${inside ? ", in range" : ""}: ${state}`;
    }
    if (kind === "alarms") {
      const causes = there.notices.map(({ cause }) => cause);
      return causes.length ? at + causes.join("; ") : "";
    }
    const { facts, value, unit } = CURVES[kind](story);
    const last = facts.findLast((fact) => fact.at_s <= there.atS);
    return last ? `${at}${name} ${value(last).toFixed(0)} ${unit}` : "";
  }
}

const CURVES = {
  battery: (story) => ({ facts: story.battery, value: (fact) => fact.battery_percent, most: 100, unit: "%" }),
  link: (story) => {
    const most = story.link.reduce((longest, fact) => Math.max(longest, 1000 * fact.round_trip_s), 1);
    return { facts: story.link, value: (fact) => 1000 * fact.round_trip_s, most, unit: "ms" };
  },
};

// What has a lane; what a log does not tell has none.
function lanesOf(story) {
  const servers = story.servers.map((name) => ({ kind: "server", name }));
  const others = [["open", story.open], ["detours", story.beside], ["alarms", story.notice], ["battery", story.battery], ["link", story.link]];
  const told = others.filter(([, facts]) => facts.length).map(([kind]) => ({ kind, name: kind }));
  return [{ kind: "calls", name: "calls" }, ...servers, ...told];
}

// When it left the line.
function beganS({ at_s, delay_s, queued_s = 0 }) {
  return at_s - delay_s + queued_s;
}

// How many answers are open from each second on at which that changes.
function openOver(story) {
  const changes = story.open.flatMap(({ at_s, until_s }) => [[at_s, 1], [until_s, -1]]);
  let number = 0;
  return changes.filter(([atS]) => atS < Infinity).sort(([one], [other]) => one - other).map(([at_s, more]) => ({ at_s, number: (number += more) }));
}

// Each fact with the second at which the next one takes its place.
function stretches(facts, endsS) {
  return facts.map((fact, index) => [fact, facts[index + 1]?.at_s ?? endsS]);
}

// Each notice with the second at which its cause was over; cautions first, so that alarms lie above them.
function held(story) {
  const [open, found] = [new Map(), []];
  for (const notice of story.notice) {
    const before = open.get(notice.key);
    if (before) found.push([before, notice.at_s]);
    open.delete(notice.key);
    if (notice.cause) open.set(notice.key, notice);
  }
  for (const notice of open.values()) found.push([notice, story.endsS]);
  return found.sort(([one], [other]) => (one.level === "alarm") - (other.level === "alarm"));
}
