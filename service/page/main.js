// The router: `#/<view>?<query>` shows views/<view>.js.

import { address, caseOf, readAddress } from "./address.js";
import { loadContract } from "./contract.js";
import { announce, announceAway, element } from "./elements.js";
import { untilAnswered } from "./lost.js";
import { followPrinting } from "./print.js";
import { isLost, keyNeeds, request, useKey } from "./service.js";
import { followTheme } from "./theme.js";
import { followUnits, showUnits } from "./units.js";
import { unreadNote } from "./unread.js";

const VIEWS = {
  explore: "Explore",
  "critical-angle": "Critical angle",
  "how-sure": "How sure",
  walls: "Walls",
  map: "Map",
  jobs: "Jobs",
};

const main = document.getElementById("view");
const units = document.getElementById("units");
let leave;
let shown = 0;

async function show() {
  const { view, query } = readAddress(location.hash);
  if (!(view in VIEWS)) return location.replace("#/explore");
  showUnits(query.get("units"), units);
  const turn = ++shown;
  if (turn > 1) main.focus();
  leave?.();
  leave = undefined;
  markCurrent(view);
  announce("Loading ...");
  const root = element("div.view");
  main.replaceChildren(root);
  try {
    const [{ show: build }] = await Promise.all([import(`./views/${view}.js`), loadContract()]);
    if (turn !== shown) return;
    announce("");
    const ending = await build(root, query);
    if (turn === shown) {
      leave = ending;
      root.prepend(...[unreadNote(view, query)].filter(Boolean));
    }
    else ending?.();
  } catch (error) {
    if (turn !== shown) return;
    announce("");
    const isModule = error instanceof TypeError && /import|module/i.test(error.message);
    const words = isModule || isLost(error) ? "The service does not answer. Trying again." : `This view cannot be shown: ${error.message}`;
    root.replaceChildren(element("p.problem", { role: "alert" }, words));
    if (isModule || isLost(error)) await showOnceBack(turn, words, isModule);
  }
}

/** Show the view as soon as the service answers; reload the page if a module failed, since browsers may remember the failure. */
async function showOnceBack(turn, words, isModule) {
  announceAway(words);
  await untilAnswered(() => request("livez"), new AbortController().signal);
  announceAway("");
  if (turn !== shown) return;
  if (isModule) location.reload();
  else show();
}

function markCurrent(view) {
  document.title = `${VIEWS[view]} - ricochet`;
  for (const link of document.querySelectorAll("nav a")) {
    const isCurrent = readAddress(link.hash).view === view;
    link.ariaCurrent = isCurrent ? "page" : null;
    if (isCurrent) link.scrollIntoView({ block: "nearest", inline: "nearest" }); // on a small phone the links may not all fit
  }
}

async function showVersions() {
  const { libraries, engine_version: engine } = (await request("version")).data;
  document.getElementById("versions").textContent = `ricochet ${libraries.ricochet}, engine ${engine}.`;
}

function offerKey() {
  const form = document.getElementById("key");
  keyNeeds.addEventListener("needed", () => (form.hidden = false));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    useKey(document.getElementById("key-value").value);
    form.hidden = true;
    show();
  });
}

document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // following the link would replace the address of the view in the hash
  main.focus();
});
followTheme(document.getElementById("theme"));
followUnits(units, () => {
  const { view, query } = readAddress(location.hash);
  history.replaceState(null, "", address(view, query));
  show();
});
followPrinting();
offerKey();
document.querySelector("nav").addEventListener("click", ({ target }) => {
  const { query } = readAddress(location.hash);
  if (target.hash) target.hash = address(readAddress(target.hash).view, caseOf(query)); // the next view shows the same case
});
addEventListener("hashchange", show);
show();
showVersions().catch(() => {}); // the view itself reports that the service does not answer
