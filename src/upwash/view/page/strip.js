// The flight at a glance: how far it is, when it ends, which server it uses and next, and how the vehicle is.

import { told } from "./clock.js";
import { element, write } from "./element.js";

const CELLS = ["progress", "expected end", "server", "saved so far", "battery", "link", "altitude", "speed", "on the ground in"];
const OF_SERVERS = ["server", "saved so far", "link"]; // hidden where no server is known
const ON_TIME = 0.01; // of the mission: a difference from the forecast that is not worth a word
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
    const down = moment.isOver ? null : moment.recent("down", STALE_S);
    this.#write("on the ground in", down ? `${down.down_s.toFixed(0)} s` : "");
    this.#hide("on the ground in", !down);
    for (const name of OF_SERVERS) this.#hide(name, Boolean(story.plan) && !story.known.size);
  }

  #hide(name, isHidden) {
    this.values.get(name).closest("div").hidden = isHidden;
  }

  #write(name, words) {
    const value = this.values.get(name);
    write(value, words || "unknown");
    value.classList.toggle("unknown", !words);
  }
}

// When the mission is over, against its forecast; of one without a forecast, when the last waypoint is reached.
function expectedEnd(moment) {
  const { story, reached } = moment;
  const nowS = story.missionS(moment.atS);
  if (moment.isOver) {
    const ended = `${story.isCompleted ? "completed" : "ended"} after ${told(story.missionS(story.endsS))}`;
    return story.isCompleted && moment.lateS !== null ? `${ended}, ${againstForecast(moment)}` : ended;
  }
  if (moment.expectedEndS !== null) return `${told(moment.expectedEndS)}, ${againstForecast(moment)}`;
  if (!story.began || !reached) return "";
  const lastS = Math.max(nowS, (moment.reachedAtS / reached) * story.waypoints);
  return reached < story.waypoints ? `last waypoint at ${told(lastS)}` : "last waypoint reached";
}

function againstForecast(moment) {
  const { lateS, failed } = moment;
  if (Math.abs(lateS) < Math.max(1, ON_TIME * moment.story.forecast.ends_s)) return "as forecast";
  if (lateS < 0) return `${told(-lateS)} early`;
  return failed.length ? `${told(lateS)} late: ${failed.join(", ")} failed` : `${told(lateS)} late`;
}

// The one in use, and the next of the plan with the time until the drone is in its range.
function serverInWords(moment) {
  const [used] = moment.using;
  const now = used ? `${used.server} ${used.state}` : "no server";
  const next = nextServer(moment, used?.server);
  return next ? `${now} → ${next.server} in ${told(next.inS)}` : now;
}

// The first server in whose range a waypoint ahead lies that lies not in that of the one in use.
function nextServer(moment, current) {
  const { story, reached } = moment;
  if (!story.plan || moment.isOver) return null;
  const covers = ([east, north, radius], place) => Math.hypot(place[0] - east, place[1] - north) <= radius;
  const ranges = Object.entries(story.plan.ranges);
  for (let index = reached; index < story.waypoints; index += 1) {
    const place = story.plan.waypoints_m[index];
    const covering = ranges.filter(([, range]) => covers(range, place)).map(([server]) => server);
    if (current ? covering.includes(current) : !covering.length) continue;
    const atS = arrivalS(moment, index);
    if (atS === null) return null;
    return { server: covering[0] ?? "no server", inS: Math.max(0, atS - story.missionS(moment.atS)) };
  }
  return null;
}

// When a waypoint ahead is reached: by the forecast, or else at the pace so far; null where neither is known.
function arrivalS(moment, index) {
  const { story, reached } = moment;
  if (moment.lateS !== null) {
    const { reached_s } = story.forecast;
    return reached_s[index - (story.waypoints - reached_s.length)] + moment.lateS;
  }
  return reached ? ((index + 1) * moment.reachedAtS) / reached : null;
}
