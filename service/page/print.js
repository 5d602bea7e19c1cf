// Printing: plots are scaled to fit the sheet, in light colours.

import { themeChanges } from "./theme.js";

/** Prepare every plot before the page is printed, and restore the plots and the theme afterwards. */
export function followPrinting() {
  const root = document.documentElement;
  let theme;
  const paint = (name) => {
    if (root.dataset.theme === name) return;
    root.dataset.theme = name;
    themeChanges.dispatchEvent(new Event("change"));
  };
  addEventListener("beforeprint", () => {
    theme = root.dataset.theme;
    for (const svg of document.querySelectorAll(".drawing .main-svg")) svg.setAttribute("viewBox", `0 0 ${svg.getAttribute("width")} ${svg.getAttribute("height")}`);
    paint("light");
  });
  addEventListener("afterprint", () => {
    for (const svg of document.querySelectorAll(".drawing .main-svg")) svg.removeAttribute("viewBox");
    paint(theme);
  });
}
