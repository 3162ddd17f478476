// Sorts `table.sortable` by a column: a button in each heading; the third click gives the order of the page back.
(() => {
  "use strict";
  const NEXT = { none: "first", first: "second", second: "none" };

  class Sorted {
    constructor(table) {
      this.body = table.tBodies[0];
      this.rows = [...this.body.rows];
      this.heads = [...table.tHead.rows[0].cells];
      this.paper = table.querySelector("caption input");
      this.column = 0;
      this.state = "none";
      this.heads.forEach((head, column) => {
        const button = document.createElement("button");
        button.type = "button";
        button.append(...head.childNodes);
        if (!button.textContent.trim()) button.textContent = "row";
        button.onclick = () => this.sort(column, column === this.column ? NEXT[this.state] : "first");
        head.append(button);
      });
      if (this.paper) {
        this.paper.closest("label").hidden = false;
        this.paper.onchange = () => this.sort(this.column, this.state);
      }
    }
    value(row) {
      const cell = row.cells[this.column], { ours, paper } = cell.dataset;
      if (ours === undefined && paper === undefined) return cell.firstChild?.textContent ?? "";
      const text = this.paper?.checked ? paper : ours;
      return text === undefined || text === "" ? NaN : Number(text);
    }
    sort(column, state) {
      [this.column, this.state] = [column, state];
      const best = this.heads[column].dataset.better;     // the first click puts the best on top
      const up = (best === undefined || best === "lower") === (state === "first");
      const values = new Map(this.rows.map((row) => [row, this.value(row)]));
      const order = [...this.rows];
      if (state !== "none") order.sort((a, b) => {
        const [x, y] = [values.get(a), values.get(b)];
        if (typeof x === "string") return (up ? 1 : -1) * x.localeCompare(String(y), undefined, { numeric: true });
        if (isNaN(x) || isNaN(y)) return isNaN(x) - isNaN(y);   // rows without a number come last
        return up ? x - y : y - x;
      });
      this.body.replaceChildren(...order);
      this.body.classList.toggle("sorted", state !== "none");
      this.heads.forEach((head) => head.removeAttribute("aria-sort"));
      if (state !== "none") this.heads[column].setAttribute("aria-sort", up ? "ascending" : "descending");
    }
  }

  document.querySelectorAll("table.sortable").forEach((table) => { table.kinema = new Sorted(table); });
})();
