// The page's address: read it, change it, go to another view.

const NAMES = [
  "view", "identification", "tab", "joint", "limb", "measurement", "robot", "design", "campaign", "diagnosis", "pair", "resource", "sort", "filter", "archived", "from", "to",
];

/** What the address asks for: { view, identification, tab, joint, limb, measurement, robot, from, to }, "" where it says nothing. */
export function asked() {
  const query = new URLSearchParams(location.search);
  return Object.fromEntries(NAMES.map((name) => [name, query.get(name) ?? ""]));
}

/** The address that shows this. */
export function address(wanted) {
  const given = NAMES.filter((name) => wanted[name]).map((name) => [name, wanted[name]]);
  const text = new URLSearchParams(given).toString();
  return text ? `/?${text}` : "/";
}

/** Go to another view or model: a step that Back undoes. `note` is there for the view to take up, once. */
export function go(wanted, note = null) {
  history.pushState(note, "", address(wanted));
  dispatchEvent(new PopStateEvent("popstate"));
}

/** Remember a choice within the view; the page has changed already. */
export function remember(part) {
  history.replaceState(null, "", address({ ...asked(), ...part }));
}

/** A link that changes what is shown without loading the page anew. */
export function follow(event) {
  const link = event.target.closest?.("a[href^='/?'], a[href='/']");
  if (!link || event.defaultPrevented || event.button || event.metaKey || event.ctrlKey || event.shiftKey) return;
  event.preventDefault();
  history.pushState(null, "", link.getAttribute("href"));
  dispatchEvent(new PopStateEvent("popstate"));
}

/** What was noted for the view on the way to it; null afterwards. */
export function takeNote() {
  const note = history.state;
  if (note) history.replaceState(null, "");
  return note;
}
