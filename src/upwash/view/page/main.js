// Puts the page together: stories come in, the clock says which moment is shown, flights show it.

import { Clock, told } from "./clock.js";
import { write } from "./element.js";
import { Feed } from "./feed.js";
import { Flight } from "./flight.js";
import { Colours, Places } from "./places.js";

const KEY_S = 5; // that an arrow key moves
const SILENT_S = 5; // a flight tells where it is every second

const on = (id) => document.getElementById(id);
const clock = new Clock();
const colours = new Colours(() => flights.forEach((flight) => flight.restyle(clock.nowS)));
const places = new Places(colours);
let flights = [];
let frame = null;

const feed = new Feed({
  opened(stories, tiles) {
    flights = stories.map((story, log) => {
      return new Flight(story, log, { places, tiles, picked: (call) => seek(story.missionS(call.at_s)) });
    });
    on("flights").replaceChildren(...flights.map((flight) => flight.element));
    on("flights").classList.toggle("two", flights.length > 1);
    document.title = `upwash: ${stories.map((story) => story.name).join(" and ")}`;
  },
  grown: refresh,
  summarized(summaries) {
    flights.forEach((flight, log) => flight.summarize(summaries[log]));
  },
  said(words) {
    write(on("connection"), words);
  },
});

// Shows what is new at the next frame, however much of it comes before.
function refresh() {
  frame ??= requestAnimationFrame((frameMs) => {
    frame = null;
    const more = clock.tick(frameMs);
    show();
    if (more) refresh();
  });
}

function show() {
  const { stories } = feed;
  clock.extend(Math.max(0, ...stories.map((story) => story.endS)));
  if (places.know(stories.flatMap((story) => story.servers))) flights.forEach((flight) => flight.restyle(clock.nowS));
  const limits = {
    waypoints: Math.max(0, ...stories.map((story) => story.waypoints)),
    longestS: Math.max(0.1, ...stories.map((story) => story.longestS)),
    before: stories.some((story) => story.call[0]?.waypoint === null),
  };
  for (const flight of flights) flight.show(clock.nowS, limits);
  showControls();
}

function showControls() {
  const live = feed.open && feed.stories.some((story) => story.goesOn);
  on("time").max = clock.endS.toFixed(1);
  on("time").value = clock.nowS.toFixed(1);
  on("time").setAttribute("aria-valuetext", `${told(clock.nowS)} of ${told(clock.endS)}`);
  write(on("clock"), `${told(clock.nowS)} / ${told(clock.endS)}`);
  write(on("play"), clock.playing ? "Pause" : "Play");
  on("latest").hidden = !live;
  showMode();
  on("latest").setAttribute("aria-pressed", String(clock.following));
}

// Whether the flight goes on; and where its log has fallen silent, for how long.
function showMode() {
  const [story] = feed.open ? feed.stories.filter((each) => each.goesOn) : [];
  const silentS = story ? story.silentS(Date.now() / 1000) : 0;
  const silent = silentS > SILENT_S;
  write(on("mode"), !story ? "playback" : silent ? `no news for ${told(silentS)}` : "live");
  on("mode").className = !story ? "state" : silent ? "state checking" : "state ready";
}

function seek(missionS) {
  clock.seek(missionS);
  refresh();
}

// To the end of the nearest call on one side of the moment, in any of the flights.
function step(direction) {
  const ends = feed.stories.flatMap((story) => story.call.map((call) => story.missionS(call.at_s)));
  const beyond = ends.filter((end) => direction * (end - clock.nowS) > 1e-3);
  clock.pause();
  if (beyond.length) seek(direction * Math.min(...beyond.map((end) => direction * end)));
}

on("play").addEventListener("click", () => {
  if (clock.playing) clock.pause();
  else clock.play();
  refresh();
});
on("time").addEventListener("input", () => seek(Number(on("time").value)));
on("time").addEventListener("keydown", (event) => {
  const direction = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
  if (!direction) return;
  event.preventDefault();
  seek(clock.nowS + direction * KEY_S);
});
on("speed").addEventListener("change", () => (clock.speed = Number(on("speed").value)));
on("speed").value = String(clock.speed);
on("previous").addEventListener("click", () => step(-1));
on("next").addEventListener("click", () => step(1));
on("latest").addEventListener("click", () => {
  clock.follow();
  refresh();
});
setInterval(showMode, 1000);
