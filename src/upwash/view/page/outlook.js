// What lies ahead of a flight that the program flies: when it ends, which server it uses and which is next, what was saved.

import { lasting, told } from "./clock.js";
import { STALE_S } from "./story.js";

const ON_TIME = 0.01; // of the mission: a difference from the forecast that is not worth a word

// Empty where nothing of it holds: unless the program flies the mission, and after one that ended early.
export function outlook(moment) {
  if (moment.isOver) return moment.story.isCompleted ? [ended(moment)] : [];
  if (!moment.isOnMission || moment.withoutNewsS || moment.breaksOff) return [];
  const { count, places } = moment.calls;
  const saved = moment.using.length && count > (places.get("local") ?? 0) ? moment.savedS : null;
  return [
    expectedEnd(moment),
    serverInWords(moment),
    saved === null ? "" : `${lasting(saved)} saved so far`,
  ].filter(Boolean);
}

function ended(moment) {
  const { story } = moment;
  const words = `completed after ${told(story.missionS(story.endsS))}`;
  return moment.lateS === null ? words : `${words}, ${againstForecast(moment)}`;
}

// When the mission is over, against its forecast; of one without a forecast, when the last waypoint is reached.
function expectedEnd(moment) {
  const { story, reached } = moment;
  if (moment.expectedEndS !== null) return `over at ${told(moment.expectedEndS)}, ${againstForecast(moment)}`;
  if (!story.began || !reached) return "";
  const lastS = Math.max(story.missionS(moment.atS), (moment.reachedAtS / reached) * story.waypoints);
  return reached < story.waypoints ? `last waypoint at ${told(lastS)}` : "last waypoint reached";
}

function againstForecast(moment) {
  const { lateS, failed } = moment;
  if (Math.abs(lateS) < Math.max(1, ON_TIME * moment.story.forecast.ends_s)) return "as forecast";
  if (lateS < 0) return `${told(-lateS)} early`;
  const back = moment.count("turn");
  const why = [failed.length ? `${failed.join(", ")} failed` : "", back ? `turned back ${often(back)}` : ""];
  return [`${told(lateS)} late`, why.filter(Boolean).join(", ")].filter(Boolean).join(": ");
}

function often(times) {
  return times === 1 ? "once" : `${times} times`;
}

// The one in use with its round trip, and the next of the plan with the time until the drone is in its range.
function serverInWords(moment) {
  if (moment.story.plan && !moment.story.known.size) return "";
  const [used] = moment.using;
  const link = moment.recent("link", STALE_S);
  const trip = used && link?.server === used.server ? ` (${(1000 * link.round_trip_s).toFixed(0)} ms)` : "";
  const now = used ? `${used.server} ${used.state}${trip}` : "no server";
  const next = nextServer(moment, used?.server);
  const when = next?.inS >= 1 ? ` in ${told(next.inS)}` : ""; // of one that is overdue nobody knows
  return next ? `${now} → ${next.server}${when}` : now;
}

// The first usable server in whose range a waypoint ahead lies that lies not in that of the one in use.
function nextServer(moment, current) {
  const { story, reached, position } = moment;
  if (!story.plan) return null;
  const covers = ([east, north, radius], place) => Math.hypot(place[0] - east, place[1] - north) <= radius;
  const ranges = [...story.plan.ranges].filter(([server]) => moment.step(server)?.tone !== "trouble");
  const here = position ? ranges.filter(([, range]) => covers(range, [position.east_m, position.north_m])) : [];
  const within = new Set(here.map(([server]) => server)); // no time is left until these
  for (let index = reached; index < story.waypoints; index += 1) {
    const place = story.plan.waypoints_m[index];
    const covering = ranges.filter(([, range]) => covers(range, place)).map(([server]) => server);
    if (current ? covering.includes(current) : !covering.some((server) => !within.has(server))) continue;
    const atS = arrivalS(moment, index);
    if (atS === null) return null;
    const server = covering.find((name) => !within.has(name)) ?? covering[0] ?? "no server";
    return { server, inS: Math.max(0, atS - story.missionS(moment.atS)) };
  }
  return null;
}

// When a waypoint ahead is reached: by the forecast, or else at the pace so far; null where neither is known.
function arrivalS(moment, index) {
  const { story, reached } = moment;
  if (moment.lateS !== null) {
    const { reached_s } = story.forecast;
    const forecastS = reached_s[index - (story.waypoints - reached_s.length)];
    return forecastS === undefined ? null : forecastS + moment.lateS;
  }
  return reached ? ((index + 1) * moment.reachedAtS) / reached : null;
}
