// Storage in the browser. If the browser blocks it, as it does together with cookies, texts are kept until the page is closed.

const memory = new Map();

/** Return the text stored under a name; undefined if there is none. */
export function kept(name, area = "localStorage") {
  try {
    return window[area].getItem(name) ?? memory.get(name);
  } catch {
    return memory.get(name);
  }
}

/** Store text under a name, in this browser or, in the area `sessionStorage`, in this tab. */
export function keep(name, text, area = "localStorage") {
  memory.set(name, text);
  try {
    window[area].setItem(name, text);
  } catch {
    // Storage is blocked or full; `memory` has the text.
  }
}
