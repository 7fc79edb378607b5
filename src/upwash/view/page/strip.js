// The flight at a glance: how far it is, when it ends, which server it uses and next, and how the vehicle is.

import { told } from "./clock.js";
import { element, write } from "./element.js";

const CELLS = ["progress", "expected end", "server", "saved so far", "battery", "link", "altitude", "speed"];
const STALE_S = 5; // what the vehicle told longer ago says nothing about now

export class Strip {
  constructor() {
    this.bar = element("progress", { max: "1", value: "0", "aria-label": "Waypoints reached" });
    this.values = new Map(CELLS.map((name) => [name, element("span")]));
    const cells = CELLS.map((name) => {
      const value = element("dd", {}, this.values.get(name), ...(name === "progress" ? [this.bar] : []));
      return element("div", {}, element("dt", {}, name), value);
    });
    this.element = element("dl", { class: "strip" }, ...cells);
  }

  show(moment) {
    const { story } = moment;
    const { reached } = moment;
    this.bar.value = story.waypoints ? reached / story.waypoints : 0;
    this.#write("progress", story.waypoints ? `${reached} of ${story.waypoints}` : "");
    this.#write("expected end", expectedEnd(moment));
    this.#write("server", serverInWords(moment));
    const saved = moment.calls.count ? moment.savedS : null;
    this.#write("saved so far", saved === null ? "" : `${(Math.round(10 * saved) / 10 + 0).toFixed(1)} s`); // no -0.0
    const battery = moment.last("battery");
    this.#write("battery", battery ? `${battery.battery_percent.toFixed(0)} %` : "");
    const [link, motion] = [moment.recent("link", STALE_S), moment.recent("motion", STALE_S)];
    this.#write("link", link ? `${(1000 * link.round_trip_s).toFixed(0)} ms to ${link.server}` : "");
    const place = moment.position;
    this.#write("altitude", place ? `${place.altitude_m.toFixed(0)} m` : "");
    this.#write("speed", motion ? `${motion.ground_speed_m_s.toFixed(1)} m/s` : "");
  }

  #write(name, words) {
    const value = this.values.get(name);
    write(value, words || "unknown");
    value.classList.toggle("unknown", !words);
  }
}

// When the last waypoint is reached, at the pace so far; the way home is not known to the page.
function expectedEnd(moment) {
  const { story, reached } = moment;
  const nowS = story.missionS(moment.atS);
  if (moment.isOver) return `${story.isCompleted ? "completed" : "ended"} after ${told(story.missionS(story.endsS))}`;
  if (!story.began || !reached) return "";
  const lastS = Math.max(nowS, (moment.reachedAtS / reached) * story.waypoints);
  return reached < story.waypoints ? `last waypoint at ${told(lastS)}` : "last waypoint reached";
}

// The one in use, and the next of the plan with the time until the drone is in its range.
function serverInWords(moment) {
  const [used] = moment.using;
  const now = used ? `${used.server} ${used.state}` : "no server";
  const next = nextServer(moment, used?.server);
  return next ? `${now} → ${next.server} in ${told(next.inS)}` : now;
}

// The first server in whose range a waypoint ahead lies that lies not in that of the one in use, by the pace so far.
function nextServer(moment, current) {
  const { story, reached } = moment;
  if (!story.plan || !reached || moment.isOver) return null;
  const paceS = moment.reachedAtS / reached;
  const covers = ([east, north, radius], place) => Math.hypot(place[0] - east, place[1] - north) <= radius;
  const ranges = Object.entries(story.plan.ranges);
  for (let index = reached; index < story.waypoints; index += 1) {
    const place = story.plan.waypoints_m[index];
    const covering = ranges.filter(([, range]) => covers(range, place)).map(([server]) => server);
    if (current ? covering.includes(current) : !covering.length) continue;
    const inS = Math.max(0, (index + 1) * paceS - story.missionS(moment.atS));
    return covering.length ? { server: covering[0], inS } : { server: "no server", inS };
  }
  return null;
}
