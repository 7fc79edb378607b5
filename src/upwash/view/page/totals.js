// Running totals by key, so that how many there were by any moment, and how much, is found by a search.

export class Totals {
  #entries = new Map(); // by key: after each addition, its time, the sum and the number so far

  add(key, atS, amount) {
    if (!this.#entries.has(key)) this.#entries.set(key, []);
    const entries = this.#entries.get(key);
    const { sum, number } = entries.at(-1) ?? { sum: 0, number: 0 };
    entries.push({ at_s: atS, sum: sum + amount, number: number + 1 });
  }

  // By key, in the keys' order, what was added by then: its sum, number and mean.
  until(atS) {
    const totals = new Map();
    for (const key of [...this.#entries.keys()].sort()) {
      const entries = this.#entries.get(key);
      const last = entries[countUntil(entries, atS) - 1];
      if (last) totals.set(key, { ...last, mean: last.sum / last.number });
    }
    return totals;
  }
}

// How many of the facts, which are in the order of their time, lie at or before the moment.
export function countUntil(facts, atS) {
  let [low, high] = [0, facts.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (facts[middle].at_s <= atS + 1e-6) low = middle + 1;
    else high = middle;
  }
  return low;
}
