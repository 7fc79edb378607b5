// The stories as they come from the server, and whether more can come.

import { Story } from "./story.js";

const LOST = "The connection to the program behind this page is lost; trying again.";
const ENDED = "The program behind this page has ended. What it told is still here; upwash view shows the log again.";

export class Feed {
  constructor({ opened, grown, summarized, said }) {
    this.stories = [];
    this.open = true;
    const source = new EventSource("events");
    source.addEventListener("page", (message) => {
      if (this.stories.length === 0) {
        const page = JSON.parse(message.data);
        this.stories = page.logs.map((name) => new Story(name));
        opened(this.stories, page);
      }
      said("");
    });
    source.addEventListener("facts", (message) => {
      const batch = JSON.parse(message.data);
      this.stories[batch.log].take(batch);
      grown();
    });
    source.addEventListener("summaries", (message) => summarized(JSON.parse(message.data)));
    source.addEventListener("end", () => {
      source.close();
      this.open = false;
      for (const story of this.stories) story.isBehind = false;
      said(ENDED);
      grown();
    });
    source.addEventListener("error", () => said(LOST));
  }
}
