// Puts the page together: stories come in, the clock says which moment is shown, views show it.

import { Banner } from "./banner.js";
import { Bar } from "./bar.js";
import { Clock, secondsOf, told } from "./clock.js";
import { element, write } from "./element.js";
import { Feed } from "./feed.js";
import { Flights } from "./flights.js";
import { Lanes } from "./lanes.js";
import { Colours, Places } from "./places.js";
import { STALE_S } from "./story.js";
import { align } from "./timeline.js";

const KEY_S = 5; // that an arrow key moves
const GLIMPSE_MS = 2000;
const LINK_MS = 500; // of rest, after which the address names the moment
const MOST = 3; // flights of one drone at a time

const on = (id) => document.getElementById(id);
const clock = new Clock();
const colours = new Colours(() => {
  view?.restyle();
  if (view) refresh();
});
const places = new Places(colours);
const lanes = new Lanes(on("lanes"), on("time"), places, refresh);
const banner = new Banner(on("alarms"), on("cautions"));
const bar = new Bar();
let view = null; // all flights that are shown
let summaries = {};
let title = "upwash";
let desk = null; // where reviews go
let asked = secondsOf(location.hash); // the moment that the address names, until it is shown
let frame = null;
let glimpse = null;
let linked = null;

const feed = new Feed({
  opened(stories, page, reviews) {
    desk = reviews;
    const isChoice = !page.together && stories.length > MOST;
    setView(isChoice ? stories.slice(0, 1) : stories, 0, page);
    if (isChoice) offerChoice(stories, page);
    const summary = document.querySelector(".together");
    if (summary) on("page").before(summary);
    title = listed(stories.map((story) => story.name));
  },
  grown,
  summarized(told) {
    summaries = told;
    view.summarize(summaries);
    refresh();
  },
  said(words) {
    write(on("connection"), words);
  },
});

function setView(stories, log, { tiles, together }) {
  view = new Flights(stories, log, { places, lanes, tiles, picked, desk, changed: refresh, together });
  view.summarize(summaries);
  on("flights").replaceChildren(...view.elements);
}

function offerChoice(stories, page) {
  const select = element("select", {}, ...stories.map(({ name }, log) => element("option", { value: log }, name)));
  select.addEventListener("change", () => {
    const log = Number(select.value);
    setView([stories[log]], log, page);
    clock.follow();
    refresh();
  });
  on("controls").prepend(element("label", { class: "which" }, element("span", { class: "unseen" }, "Flight"), select));
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
  if (!view) return;
  const { stories } = feed;
  align(stories, view.together);
  clock.extend(Math.max(0, ...view.stories.map((story) => story.clockS(story.endsS))));
  if (asked !== null && asked <= clock.endS) {
    clock.seek(asked);
    asked = null;
  }
  const operations = stories.flatMap((story) => [...story.operations]);
  if (places.know(stories.flatMap((story) => story.servers), operations)) view.restyle();
  const moments = view.show(clock.nowS, clock.endS);
  const { watched, number } = view;
  const who = bar.show(watched.at(clock.nowS), stories.length > 1 ? watched.name : "", view.together ? moments : [], number);
  const alarms = banner.show(moments);
  document.title = [alarms ? "ALARM" : "", who, title].filter(Boolean).join(" · ");
  showControls();
}

function showControls() {
  const live = feed.stories.some((story) => story.goesOn);
  on("time").setAttribute("aria-valuetext", `${told(clock.nowS)} of ${told(clock.endS)}`);
  write(on("clock"), [`${told(clock.nowS)} / ${told(clock.endS)}`, timeOfDay()].filter(Boolean).join(" · "));
  write(on("play"), clock.playing ? "Pause" : "Play");
  on("latest").hidden = !live;
  on("controls").classList.toggle("following", live && clock.following);
  showMode();
  on("latest").setAttribute("aria-pressed", String(clock.following));
  if (!clock.playing && !clock.following && asked === null) {
    clearTimeout(linked);
    linked = setTimeout(() => history.replaceState(null, "", `#t=${told(clock.nowS)}`), LINK_MS);
  }
}

// Of the moment that is shown; empty where the flights have none, or none in common.
function timeOfDay() {
  const times = new Set(view.stories.map((story) => story.timeOfDay(clock.nowS + story.zeroS)));
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

// To the end of the nearest call on one side of the moment, in the flight that is looked at.
function step(direction) {
  const ends = view.watched.call.map((call) => view.watched.clockS(call.at_s));
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
  const { value } = on("time"); // which is rounded
  seek(Number(value) < Number(clock.endS.toFixed(1)) ? Number(value) : clock.endS);
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
  const call = on("waypoint").value === "" ? null : view.watched.call.find(({ waypoint }) => waypoint === Number(on("waypoint").value));
  if (call) picked(view.watched, call);
});
on("previous").addEventListener("click", () => step(-1));
on("next").addEventListener("click", () => step(1));
on("latest").addEventListener("click", () => {
  clock.follow();
  refresh();
});
addEventListener("hashchange", () => {
  asked = secondsOf(location.hash);
  refresh();
});
for (const skip of document.querySelectorAll(".skip")) {
  skip.addEventListener("click", () => {
    if (skip.dataset.to === "play") on("play").focus();
    else if (view) enterFindings();
  });
}
document.addEventListener("keydown", (event) => {
  const { key, target } = event;
  if (!view || event.ctrlKey || event.altKey || event.metaKey || target.tagName === "SELECT") return;
  if (target.matches("input[type=text], input[type=number]")) return;
  const way = wayOf(key, event.repeat, view.findings.element.contains(target), target);
  if (!way) return;
  event.preventDefault();
  way();
});

// What a key does; keys that parts of the page have for themselves do nothing else there.
function wayOf(key, isRepeat, isHere, target) {
  const finding = isRepeat ? null : view.findings.wayOf(key, isHere);
  if (finding) return () => (view.dock.open("findings"), finding());
  if (/^[1-9]$/.test(key)) return () => view.focus(Number(key) - 1);
  const letters = { d: () => view.dock.flip(), f: enterFindings };
  if (letters[key]) return letters[key];
  if (target.closest("button, summary, input, [tabindex]:not(body)")) return null;
  const [back, on] = [() => seek(clock.nowS - KEY_S), () => seek(clock.nowS + KEY_S)];
  return { " ": toggle, ArrowLeft: back, ArrowRight: on, Home: () => seek(0), End: () => seek(clock.endS) }[key];
}

function enterFindings() {
  view.dock.open("findings");
  view.findings.enter();
}

// On paper everything is light, at once.
for (const [event, isPaper] of [["beforeprint", true], ["afterprint", false]]) {
  addEventListener(event, () => {
    document.documentElement.classList.toggle("paper", isPaper);
    colours.forget();
    show();
    view?.map.flush();
  });
}

on("page").hidden = false; // which does nothing without scripts
on("bar").append(bar.element);
write(on("connection"), "Loading the flight.");
feed.start();
setInterval(() => {
  const before = on("mode").textContent;
  showMode();
  if (feed.stories.length && on("mode").textContent !== before) refresh(); // what a silent flight told says less and less
}, 1000);
