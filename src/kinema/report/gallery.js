// The gallery: which methods are shown, side by side or one over the other, prompt by prompt.
(() => {
  "use strict";
  const MOST = 6;                                         // bodies that one player shows: as many as there are colours
  const MANY = 40;                                        // sources up to which all are shown at first

  function element(name, properties = {}, ...children) {
    const made = Object.assign(document.createElement(name), properties);
    made.append(...children);
    return made;
  }
  const same = (pack) => pack.split("/").at(-1);          // packs are named by their content, wherever they lie

  class Gallery {
    constructor(section) {
      this.section = section;
      this.groups = JSON.parse(section.querySelector("script").textContent);
      this.sources = new Map();                           // each once, however many tables have it
      for (const group of this.groups)
        for (const source of group.sources)
          if (!this.sources.has(same(source.pack))) this.sources.set(same(source.pack), source);
      const first = this.sources.size <= MANY ? this.groups : this.groups.slice(0, 1);
      this.chosen = new Set(first.flatMap((group) => group.sources.map((source) => same(source.pack))));
      this.overlay = false;
      this.sought = "";
      this.figures = new Map();
      this.prompts = this.readPrompts();
      this.makeChoice(section.querySelector(".kinema-choice"));
      this.show();
    }
    readPrompts() {                                       // the k-th motion of a text is the same clip for all sources
      const prompts = new Map();
      for (const [key, source] of this.sources) {
        const seen = {};
        source.motions.forEach((motion, index) => {
          const nth = seen[motion.text] = (seen[motion.text] ?? 0) + 1;
          const name = JSON.stringify([motion.text, nth]);
          if (!prompts.has(name)) prompts.set(name, { text: motion.text, entries: [] });
          prompts.get(name).entries.push({ key, source, index, motion });
        });
      }
      return [...prompts.values()];
    }
    makeChoice(place) {
      this.count = element("summary");
      const fieldsets = this.groups.map((group) => this.makeGroup(group));
      const overlay = element("button", { type: "button", className: "kinema-overlay", textContent: "Overlay",
        title: "Show the chosen methods in one player for each prompt" });
      overlay.setAttribute("aria-pressed", "false");
      overlay.onclick = () => {
        this.overlay = !this.overlay;
        overlay.setAttribute("aria-pressed", String(this.overlay));
        this.show();
      };
      const search = element("input", { type: "search", placeholder: "Find a prompt" });
      search.setAttribute("aria-label", "Find a prompt");
      search.oninput = () => { this.sought = search.value.toLowerCase(); this.show(); };
      place.append(element("div", { className: "kinema-bar" }, overlay, search),
                   element("details", { open: matchMedia("(min-width: 700px)").matches }, this.count, ...fieldsets));
    }
    makeGroup(group) {
      const keys = group.sources.map((source) => same(source.pack));
      const all = element("button", { type: "button", textContent: "all" });
      const none = element("button", { type: "button", textContent: "none" });
      all.onclick = () => { keys.forEach((key) => this.chosen.add(key)); this.show(); };
      none.onclick = () => { keys.forEach((key) => this.chosen.delete(key)); this.show(); };
      const boxes = group.sources.map((source) => {
        const box = element("input", { type: "checkbox", value: same(source.pack) });
        box.onchange = () => { this.chosen[box.checked ? "add" : "delete"](box.value); this.show(); };
        return element("label", { className: source.kind }, box, " " + source.label);
      });
      const title = element("legend", { textContent: group.title + (group.where ? ` (${group.where}) ` : " ") }, all, none);
      return element("fieldset", {}, title, ...boxes);
    }
    show() {
      const blocks = [];
      for (const { text, entries } of this.prompts) {
        const shown = entries.filter((entry) => this.chosen.has(entry.key));
        if (!shown.length || !text.toLowerCase().includes(this.sought)) continue;
        const playable = shown.filter((entry) => entry.motion.broken === null);
        const sets = this.overlay && playable.length ? [playable.slice(0, MOST)] : shown.map((entry) => [entry]);
        blocks.push(element("h3", { className: "kinema-group", textContent: text }),
                    element("div", { className: "kinema-grid" }, ...sets.map((set) => this.figure(text, set))));
      }
      if (!blocks.length) blocks.push(element("p", { textContent: "Nothing to show: choose a method above." }));
      this.section.querySelector(".kinema-prompts").replaceChildren(...blocks);
      this.section.querySelectorAll("input[type=checkbox]").forEach((box) => { box.checked = this.chosen.has(box.value); });
      const cut = this.overlay && this.chosen.size > MOST ? `; a player shows ${MOST} at most` : "";
      this.count.textContent = `Methods: ${this.chosen.size} of ${this.sources.size} shown${cut}`;
      kinema.scan();
    }
    figure(text, entries) {                               // made once, and shown again with its motions already read
      const packs = JSON.stringify(entries.map(({ source, index }) => [source.pack, index, source.label]));
      if (!this.figures.has(packs)) this.figures.set(packs, this.makeFigure(text, entries, packs));
      return this.figures.get(packs);
    }
    makeFigure(text, entries, packs) {
      const longest = entries.reduce((a, b) => a.motion.frames / a.motion.fps >= b.motion.frames / b.motion.fps ? a : b);
      const figure = element("figure", { className: "kinema-player" });
      const stage = element("div", { className: "kinema-stage" }), { frames, fps, broken } = longest.motion;
      const names = entries.map(({ source }, i) => element("span", {
        className: "kinema-label" + (entries.length > 1 ? ` kinema-swatch kinema-overlay-${i}` : ""),
        textContent: source.label }));
      const facts = element("span", { className: "kinema-facts", textContent: `${(frames / fps).toFixed(1)} s` });
      if (broken !== null) {
        figure.classList.add("kinema-broken");
        stage.append(element("p", { textContent: `Not finite from frame ${broken} on: this motion cannot be shown.` }));
      } else {
        Object.assign(figure.dataset, { fps, frames, packs });
        const canvas = element("canvas", { tabIndex: 0 });
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `${text}: ${entries.map(({ source }) => source.label).join(", ")}`);
        stage.append(canvas);
      }
      figure.append(stage, element("figcaption", {}, ...names, facts));
      return figure;
    }
  }

  document.querySelectorAll(".kinema-gallery").forEach((section) => { section.kinema = new Gallery(section); });
})();
