// Puts the page together: stories come in, the clock says which moment is shown, views show it.

import { Banner } from "./banner.js";
import { Bar } from "./bar.js";
import { Clock, told } from "./clock.js";
import { element, write } from "./element.js";
import { Feed } from "./feed.js";
import { Fleet } from "./fleet.js";
import { Flight } from "./flight.js";
import { FlightMap } from "./map.js";
import { Colours, Places } from "./places.js";
import { STALE_S } from "./story.js";
import { align } from "./timeline.js";

const KEY_S = 5; // that an arrow key moves
const GLIMPSE_MS = 2000;
const PHONE_PX = 480; // where more than the moment would leave the slider no room
const MOST_BESIDE = 3; // flights; of more one is shown at a time

const on = (id) => document.getElementById(id);
const clock = new Clock();
const colours = new Colours(() => {
  views.forEach((view) => view.restyle());
  if (views.length) refresh();
});
const places = new Places(colours);
const banner = new Banner(on("alarms"), on("cautions"));
let views = []; // a flight each, or a fleet
let bars = []; // one for each of them
let summaries = {};
let title = "upwash";
let together = false;
let desk = null; // where reviews go
let frame = null;
let glimpse = null;

const feed = new Feed({
  opened(stories, page, reviews) {
    together = page.together;
    desk = reviews;
    const many = !together && stories.length > MOST_BESIDE;
    const flights = many ? stories.slice(0, 1) : stories;
    setViews(together ? [fleetOf(stories, page.tiles)] : flights.map((story, log) => flightOf(story, log, page.tiles)));
    if (many) offerChoice(stories, page.tiles);
    const summary = document.querySelector(".together");
    if (summary) on("flights").before(summary);
    title = `upwash: ${listed(stories.map((story) => story.name))}`;
  },
  grown,
  summarized(told) {
    summaries = told;
    views.forEach((view) => view.summarize(summaries));
    refresh();
  },
  said(words) {
    write(on("connection"), words);
  },
});

function setViews(shown) {
  views = shown;
  views.forEach((view) => view.summarize(summaries));
  bars = views.map((view) => new Bar(together ? "the drone in focus" : view.watched.name));
  on("bars").replaceChildren(...bars.map((bar) => bar.element));
  on("flights").replaceChildren(...views.map((view) => view.element));
  on("flights").classList.toggle("beside", views.length > 1);
}

function offerChoice(stories, tiles) {
  const select = element("select", {}, ...stories.map(({ name }, log) => element("option", { value: log }, name)));
  select.addEventListener("change", () => {
    const log = Number(select.value);
    setViews([flightOf(stories[log], log, tiles)]);
    clock.follow();
    refresh();
  });
  on("controls").prepend(element("label", { class: "choice" }, element("span", { class: "unseen" }, "Flight"), select));
}

function fleetOf(stories, tiles) {
  return new Fleet(stories, { places, tiles, picked, desk, changed: refresh });
}

function flightOf(story, log, tiles) {
  const map = new FlightMap(story.name, { places, tiles, logs: [log] });
  return new Flight(story, log, { places, picked, desk, changed: refresh, map });
}

function picked(story, call) {
  seek(story.clockS(call.at_s));
}

function listed(names) {
  return names.length > 1 ? `${names.slice(0, -1).join(", ")} and ${names.at(-1)}` : names.join();
}

// What a log has told before takes a moment to come: drawing it as it grows would take longer than all the rest.
function grown() {
  if (feed.stories.some((story) => story.isBehind)) glimpse ??= setTimeout(refresh, GLIMPSE_MS);
  else refresh();
}

// Shows what is new at the next frame, however much of it comes before.
function refresh() {
  frame ??= requestAnimationFrame((frameMs) => {
    frame = null;
    clearTimeout(glimpse);
    glimpse = null;
    const more = clock.tick(frameMs);
    show();
    if (more) refresh();
  });
}

function show() {
  const { stories } = feed;
  align(stories, together);
  clock.extend(Math.max(0, ...shown().map((story) => story.clockS(story.endsS))));
  const operations = stories.flatMap((story) => [...story.operations]);
  if (places.know(stories.flatMap((story) => story.servers), operations)) views.forEach((view) => view.restyle());
  const limits = {
    waypoints: Math.max(0, ...shown().map((story) => story.waypoints)),
    longestS: Math.max(0.1, ...shown().map((story) => story.longestS)),
    before: shown().some((story) => story.call[0]?.waypoint === null),
  };
  for (const view of views) view.show(clock.nowS, limits);
  const many = feed.stories.length > 1;
  views.forEach(({ watched, stories: flown, number }, index) => {
    bars[index].show(watched.at(clock.nowS), many ? watched.name : "", flown.map((story) => story.at(clock.nowS)), number);
  });
  const alarms = banner.show(shown().map((story) => story.at(clock.nowS)));
  document.title = alarms ? `ALARM · ${title}` : title;
  showControls();
}

function shown() {
  return views.flatMap((view) => view.stories);
}

function showControls() {
  const live = feed.stories.some((story) => story.goesOn);
  on("time").max = clock.endS.toFixed(1);
  on("time").value = clock.nowS.toFixed(1);
  on("time").setAttribute("aria-valuetext", `${told(clock.nowS)} of ${told(clock.endS)}`);
  const parts = [`${told(clock.nowS)} / ${told(clock.endS)}`, timeOfDay()];
  write(on("clock"), innerWidth > PHONE_PX ? parts.filter(Boolean).join(" · ") : told(clock.nowS));
  write(on("play"), clock.playing ? "Pause" : "Play");
  on("latest").hidden = !live;
  on("controls").classList.toggle("following", live && clock.following);
  showMode();
  on("latest").setAttribute("aria-pressed", String(clock.following));
}

// Of the moment that is shown; empty where the flights have none, or none in common.
function timeOfDay() {
  const times = new Set(shown().map((story) => story.timeOfDay(clock.nowS + story.zeroS)));
  return times.size === 1 ? [...times][0] : "";
}

// Whether a flight goes on; and where the logs have fallen silent, for how long.
function showMode() {
  const live = feed.stories.filter((story) => story.goesOn);
  const silentS = Math.min(...live.map((story) => story.silentS));
  const silent = live.length > 0 && silentS > STALE_S;
  write(on("mode"), !live.length ? "playback" : silent ? `no news for ${told(silentS)}` : "live");
  on("mode").className = !live.length ? "state" : silent ? "state checking" : "state ready";
}

function seek(clockS) {
  clock.seek(clockS);
  refresh();
}

// To the end of the nearest call on one side of the moment, in any of the flights that are looked at.
function step(direction) {
  const watched = views.map((view) => view.watched);
  const ends = watched.flatMap((story) => story.call.map((call) => story.clockS(call.at_s)));
  const beyond = ends.filter((end) => direction * (end - clock.nowS) > 1e-3);
  clock.pause();
  if (beyond.length) seek(direction * Math.min(...beyond.map((end) => direction * end)));
}

function toggle() {
  if (clock.playing) clock.pause();
  else clock.play();
  refresh();
}

on("play").addEventListener("click", toggle);
on("time").addEventListener("input", () => {
  const { value, max } = on("time"); // which are rounded
  seek(Number(value) < Number(max) ? Number(value) : clock.endS);
});
on("time").addEventListener("keydown", (event) => {
  const direction = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
  if (!direction) return;
  event.preventDefault();
  seek(clock.nowS + direction * KEY_S);
});
on("speed").addEventListener("change", () => (clock.speed = Number(on("speed").value)));
on("speed").value = String(clock.speed);
on("waypoint").addEventListener("change", () => {
  const asked = on("waypoint").value;
  for (const story of asked === "" ? [] : views.map((view) => view.watched)) {
    const call = story.call.find(({ waypoint }) => waypoint === Number(asked));
    if (call) picked(story, call);
  }
});
on("previous").addEventListener("click", () => step(-1));
on("next").addEventListener("click", () => step(1));
on("latest").addEventListener("click", () => {
  clock.follow();
  refresh();
});
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.tagName === "SELECT") return;
  if (event.target.matches("input[type=text], input[type=number]")) return;
  if (reviews(event)) {
    event.preventDefault();
    return;
  }
  if (together && /^[1-9]$/.test(event.key)) views[0].focus(Number(event.key) - 1);
  if (event.target.closest("button, summary, input, [tabindex]:not(body)")) return; // these keys are theirs
  const ways = { " ": toggle, ArrowLeft: () => seek(clock.nowS - KEY_S), ArrowRight: () => seek(clock.nowS + KEY_S) };
  const way = { ...ways, Home: () => seek(0), End: () => seek(clock.endS) }[event.key];
  if (!way) return;
  event.preventDefault();
  way();
});

// Whether the key is one of those that review findings: of the flight that has the focus, else of the first.
function reviews({ key, repeat, target }) {
  const focused = views.find(({ findings }) => findings.element.contains(target));
  const { findings } = focused ?? views[0] ?? {};
  return Boolean(findings) && !findings.element.hidden && !repeat && findings.review.press(key, Boolean(focused));
}

on("controls").hidden = false; // which do nothing without scripts
write(on("connection"), "Loading the flight.");
feed.start();
setInterval(() => {
  const before = on("mode").textContent;
  showMode();
  if (feed.stories.length && on("mode").textContent !== before) refresh(); // what a silent flight told says less and less
}, 1000);
