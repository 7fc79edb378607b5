// What was found, in words.

// Under the label of the last review, and how sure that is.
export function wordsOf({ noun, what, score }) {
  const name = noun || what || "object"; // a simulated one has neither name nor score
  return score ? `${name} ${percent(score)}` : name;
}

function percent(score) {
  return `${(100 * score).toFixed(0)} %`;
}
