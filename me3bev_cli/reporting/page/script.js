"use strict";
(() => {
  // A cell without a value stays at the end, whichever way the others go.
  const compare = (a, b, way) => {
    if (a === "" || b === "") return a === b ? 0 : a === "" ? 1 : -1;
    const x = Number(a), y = Number(b);
    return way * (Number.isNaN(x) || Number.isNaN(y) ? a.localeCompare(b, "en", { numeric: true }) : x - y);
  };

  const sort = (button) => {
    const heading = button.closest("th"), table = button.closest("table"), body = table.tBodies[0];
    const column = heading.cellIndex, numeric = !heading.classList.contains("word");
    const now = heading.getAttribute("aria-sort");
    // Numbers begin with the largest, words with the first letter.
    const next = now === "none" ? (numeric ? "descending" : "ascending") : now === "ascending" ? "descending" : "ascending";
    for (const other of table.tHead.rows[0].cells) {
      if (other.hasAttribute("aria-sort")) other.setAttribute("aria-sort", "none");
    }
    heading.setAttribute("aria-sort", next);
    const way = next === "ascending" ? 1 : -1;
    const value = (row) => row.cells[column].dataset.value ?? "";
    body.append(...[...body.rows].sort((a, b) => compare(value(a), value(b), way)));
    document.getElementById("said").textContent = `sorted by ${button.textContent.trim()}, ${next}`;
  };

  // The browser's own controls would cover the lower half of a clip; they remain where scripts do not run.
  for (const button of document.querySelectorAll("button.play")) {
    const video = button.closest("figure").querySelector("video");
    video.controls = false;
    button.hidden = false;
    const show = (word) => {
      button.textContent = word;
      button.setAttribute("aria-label", `${word}: ${video.getAttribute("aria-label")}`);
    };
    video.addEventListener("play", () => {
      for (const other of document.querySelectorAll("video")) if (other !== video) other.pause();
      show("Pause");
    });
    video.addEventListener("pause", () => show("Play"));
    show("Play");
    for (const target of [button, video]) {
      target.addEventListener("click", () => (video.paused ? video.play() : video.pause()));
    }
  }

  document.addEventListener("click", (event) => {
    const button = event.target.closest("th button");
    if (button) sort(button);
  });
})();
