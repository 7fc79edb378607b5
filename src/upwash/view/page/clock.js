// The moment that is shown, in seconds of the mission, or since the first of several drones began its own.

export class Clock {
  constructor() {
    this.nowS = 0;
    this.endS = 0;
    this.playing = false;
    this.following = true; // stays at the end, however far that is
    this.speed = 10;
    this.#lastFrameMs = null;
  }

  #lastFrameMs;

  // How far the stories are told.
  extend(endS) {
    this.endS = endS;
    if (this.following || this.nowS > endS) this.nowS = endS;
  }

  play() {
    if (this.nowS >= this.endS) this.nowS = 0;
    this.playing = true;
    this.following = false;
    this.#lastFrameMs = null;
  }

  pause() {
    this.playing = false;
  }

  seek(clockS) {
    this.nowS = Math.min(Math.max(0, clockS), this.endS);
    this.following = false;
  }

  follow() {
    this.playing = false;
    this.following = true;
    this.nowS = this.endS;
  }

  // Moves on to a frame; whether there is another to come.
  tick(frameMs) {
    if (!this.playing) return false;
    const passedMs = this.#lastFrameMs === null ? 0 : frameMs - this.#lastFrameMs;
    this.#lastFrameMs = frameMs;
    this.nowS = Math.min(this.endS, this.nowS + (passedMs / 1000) * this.speed);
    if (this.nowS >= this.endS) this.playing = false;
    return this.playing;
  }
}

// The seconds of "#t=1:45" or "#t=105"; null of anything else.
export function secondsOf(hash) {
  const parts = /^#t=((?:\d+:){0,2}\d+(?:\.\d+)?)$/.exec(hash)?.[1].split(":");
  return parts ? parts.reduce((sum, part) => 60 * sum + Number(part), 0) : null;
}

// How long something takes, or how much shorter it is: "15.4 s", "3:46".
export function lasting(seconds) {
  if (Math.abs(seconds) >= 60) return `${seconds < 0 ? "-" : ""}${told(Math.abs(seconds))}`;
  return `${(Math.round(10 * seconds) / 10 + 0).toFixed(1)} s`; // no -0.0
}

export function told(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const parts = [Math.floor(whole / 60) % 60, whole % 60];
  if (whole >= 3600) parts.unshift(Math.floor(whole / 3600));
  return parts.map((part, index) => (index === 0 ? String(part) : String(part).padStart(2, "0"))).join(":");
}
