// Where reviews of findings go: to the program behind the page, or into files that the page offers.

const GONE = "The program behind this page does not answer: it did not keep the review.";
const TRIES = 3;
const AGAIN_MS = 400;

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

  // Keeps a review of a finding of that log; why it could not, empty if it could.
  async keep(log, review) {
    const line = { ...review, reviewer: this.reviewer.trim() };
    if (this.#token === null) {
      this.#made[log].push({ time: new Date().toISOString(), ...line });
      return "";
    }
    const headers = { "Content-Type": "application/json", "X-Upwash-Token": this.#token };
    const answer = await asked("review", { method: "POST", headers, body: JSON.stringify({ log, ...line }) });
    if (!answer) return GONE;
    return answer.ok ? "" : `Not kept: ${await answer.text()}.`;
  }

  // The name, the content and the number of reviews of each file that the page has to offer.
  get files() {
    const files = this.#files.map((name, log) => [name, this.#made[log].map((line) => `${JSON.stringify(line)}\n`), this.#made[log].length]);
    return files.filter(([, , count]) => count);
  }
}

// The answer; null where there is none after several tries, which do no harm: of equal reviews the last counts.
async function asked(address, request) {
  for (let tries = 0; tries < TRIES; tries += 1) {
    try {
      return await fetch(address, request);
    } catch {
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }
  return null;
}
