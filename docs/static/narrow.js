// On a phone, tables of more than four columns are shown row by row, each cell with its header.
addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("article table.docutils")) {
    const heads = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent);
    if (heads.length <= 4) continue;
    table.classList.add("wide");
    for (const row of table.querySelectorAll("tbody tr"))
      [...row.cells].forEach((cell, k) => cell.setAttribute("data-label", heads[k] || ""));
  }
});
