// Which jobs are maps: the service does not tell the fields of a job, so the browser that made it keeps its address.

const STORED = "ricochet-maps";
const MOST = 100;

/** Keep the address of the map that a job computes. */
export function rememberMap(id, address) {
  const kept = { ...known(), [id]: address };
  localStorage.setItem(STORED, JSON.stringify(Object.fromEntries(Object.entries(kept).slice(-MOST))));
}

/** Return the address of the map that a job computes; undefined if it is not known to be one. */
export function mapOf(id) {
  return known()[id];
}

function known() {
  try {
    return JSON.parse(localStorage.getItem(STORED)) ?? {};
  } catch {
    return {};
  }
}
