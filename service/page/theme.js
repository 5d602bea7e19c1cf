// The light or dark theme, as the system or the user prefers.

import { keep, kept } from "./storage.js";

const STORED = "ricochet-theme";

/** Fires `change` when the colours change. */
export const themeChanges = new EventTarget();

/** Follow the system until another theme is chosen in this <select>. */
export function followTheme(select) {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const apply = () => {
    const theme = select.value === "system" ? (dark.matches ? "dark" : "light") : select.value;
    document.documentElement.dataset.theme = theme;
    themeChanges.dispatchEvent(new Event("change"));
  };
  const before = kept(STORED);
  select.value = ["light", "dark"].includes(before) ? before : "system";
  select.addEventListener("change", () => {
    keep(STORED, select.value);
    apply();
  });
  dark.addEventListener("change", apply);
  apply();
}
