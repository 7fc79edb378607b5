// What a flight is, in a line: when and where it was, which vehicle and drone flew, under which policy, and its photos.

import { counted } from "./element.js";
import { degrees } from "./ground.js";

const DAY = { day: "numeric", month: "short", year: "numeric", hour: "2-digit", minute: "2-digit" };

// Of what the log tells, and nothing else.
export function aboutFlight(moment) {
  const { story } = moment;
  const photos = moment.count("shot");
  const parts = [
    when(story),
    degrees(story.plan, 0, 0),
    vehicle(story.firmware),
    story.began?.drone,
    story.began && `policy ${story.began.policy}`,
    photos && counted(photos, "photo"),
  ];
  return parts.filter(Boolean).join(" · ");
}

// By the clock of the browser's place.
function when({ opened, began }) {
  if (!opened) return began && "simulated";
  const epochS = opened.epoch_s + ((began ?? opened).at_s - opened.at_s);
  return new Date(1000 * epochS).toLocaleString("en-GB", DAY);
}

function vehicle(found) {
  if (!found) return "";
  const { name, version, type } = found;
  return `${[name, version].filter(Boolean).join(" ")} (${type})`;
}
