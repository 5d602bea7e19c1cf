// What the browser keeps for the page. Where it keeps nothing, as with cookies blocked, it is kept until the page is closed.

const memory = new Map();

/** Return text that is kept by a name; undefined if there is none. */
export function kept(name, area = "localStorage") {
  try {
    return window[area].getItem(name) ?? memory.get(name);
  } catch {
    return memory.get(name);
  }
}

/** Keep text by a name, in this browser or, in the area `sessionStorage`, in this tab. */
export function keep(name, text, area = "localStorage") {
  memory.set(name, text);
  try {
    window[area].setItem(name, text);
  } catch {
    // blocked or full: the memory has it
  }
}
