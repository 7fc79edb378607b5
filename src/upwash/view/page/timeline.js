// Which second of each log the page's clock begins at.

// From its own beginning for each flight; for flights of several drones from the beginning of the first of them,
// where they were in the air at the same time.
export function align(stories, together) {
  const own = stories.map((story) => story.began?.at_s ?? 0);
  const shared = together ? sharedZeros(stories) : null;
  stories.forEach((story, index) => (story.zeroS = (shared ?? own)[index]));
}

// Null where there is no time that all of them share: some are simulated, or one began when the others were over.
function sharedZeros(stories) {
  const told = stories.filter((story) => story.facts);
  const flown = told.filter((story) => story.opened);
  if (flown.length && flown.length < told.length) return null;
  const begun = told.filter((story) => story.began).sort((one, other) => beginning(one) - beginning(other));
  let overS = -Infinity;
  for (const [index, story] of begun.entries()) {
    if (index && beginning(story) > overS) return null;
    overS = Math.max(overS, opening(story) + story.endsS);
  }
  const zeroS = begun.length ? beginning(begun[0]) : Math.min(...flown.map(opening), Infinity);
  return stories.map((story) => (story.facts && zeroS < Infinity ? zeroS - opening(story) : 0));
}

// When second 0 of the log was: simulated drones of one world have that in common.
function opening(story) {
  return story.opened ? story.opened.epoch_s - story.opened.at_s : 0;
}

function beginning(story) {
  return opening(story) + story.began.at_s;
}
