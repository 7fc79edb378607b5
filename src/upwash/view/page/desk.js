// Where reviews of findings go: to the program behind the page, or into files that the page offers.

const TRIES = 3;
const AGAIN_MS = 400;
const TOO_MANY = 429;

export class Desk {
  #files; // the names of the files with reviews, by log
  #made; // lines that nobody else keeps, by log
  #token;

  constructor({ review_files, reviewing }) {
    this.#files = review_files;
    this.#made = review_files.map(() => []);
    this.#token = reviewing?.token ?? null;
    this.reviewer = reviewing?.reviewer ?? "";
  }

  // The program has ended: from now on the page keeps what is reviewed.
  end() {
    this.#token = null;
  }

  // A program answers again: it gets what it missed.
  async renew({ reviewing }) {
    this.#token = reviewing?.token ?? null;
    const missed = this.#made;
    this.#made = missed.map(() => []);
    for (const [log, lines] of missed.entries()) {
      for (const line of lines) await this.#hand(log, line);
    }
  }

  // Keeps a review of a finding of that log; why the program refuses it, empty if it is kept here or there.
  keep(log, review) {
    return this.#hand(log, { time: new Date().toISOString(), ...review, reviewer: this.reviewer.trim() });
  }

  async #hand(log, line) {
    if (this.#token === null) {
      this.#made[log].push(line);
      return "";
    }
    const { time: _, ...review } = line; // the program has a clock of its own
    const headers = { "Content-Type": "application/json", "X-Upwash-Token": this.#token };
    const answer = await asked("review", { method: "POST", headers, keepalive: true, body: JSON.stringify({ log, ...review }) });
    if (!answer) this.#made[log].push(line);
    return !answer || answer.ok ? "" : `Not kept: ${await answer.text()}.`;
  }

  // The name and the lines of each file that the page has to offer of these logs.
  filesOf(logs) {
    const files = logs.map((log) => [this.#files[log], this.#made[log].map((line) => `${JSON.stringify(line)}\n`)]);
    return files.filter(([, lines]) => lines.length);
  }
}

// The answer; null where there is none after several tries, which do no harm: of equal reviews the last counts.
async function asked(address, request) {
  for (let tries = 0; tries < TRIES; tries += 1) {
    try {
      const answer = await fetch(address, request);
      if (answer.status !== TOO_MANY) return answer;
    } catch {
      // the connection may come back
    }
    await new Promise((done) => setTimeout(done, AGAIN_MS));
  }
  return null;
}
