// How far two flights of one plan are apart: how much later the second was at each waypoint that both have reached.

import { told } from "./clock.js";

const SAME_S = 0.5;

// From each second of the page's clock at which both had reached one more waypoint.
export function behindOver(first, second) {
  const both = Math.min(first.arrivals.length, second.arrivals.length);
  return Array.from({ length: both }, (_, index) => {
    const [one, other] = [first, second].map((story) => story.clockS(story.arrivals[index].at_s));
    return { clock_s: Math.max(one, other), behind_s: other - one };
  });
}

// How far the second is behind the first at that second of the page's clock; null before both had reached a waypoint.
export function behindS(first, second, clockS) {
  return behindOver(first, second).findLast(({ clock_s }) => clock_s <= clockS)?.behind_s ?? null;
}

export function inWords(behind, first, second) {
  if (behind === null) return "";
  if (Math.abs(behind) < SAME_S) return `${second.name} is level with ${first.name}`;
  return `${second.name} is ${told(Math.abs(behind))} ${behind > 0 ? "behind" : "ahead of"} ${first.name}`;
}
