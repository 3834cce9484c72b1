// A robot as it is described: the arm, and the meshes that its description names.

import { ask } from "../api.js";
import { announce, h, put } from "../dom.js";
import { dropZone } from "../drop_zone.js";
import { counted } from "../format.js";
import { givenUp } from "../jobs.js";
import { problemBox } from "../problem.js";

/** A part of a page to be opened: the arm at zero, and a place for the files of its meshes. */
export function pictureOf(robot, signal) {
  const place = h("div");
  const meshes = h("div");
  let meant = robot;
  let turn = 0;
  const show = async () => {
    if (!element.open || place.firstChild) return;
    turn += 1;
    const mine = turn;
    try {
      const { mountArm } = await import("./arm.js");
      const { element: arm } = await mountArm(h("div"), { robotId: robot.id, signal });
      // Opened twice, or with other meshes meanwhile: the last one is shown.
      if (mine === turn) put(place, arm);
    } catch (error) {
      if (!signal.aborted && mine === turn) put(place, problemBox(error, show));
    }
  };
  const sent = (answer) => {
    meant = { ...meant, meshes: answer.meshes };
    put(place);
    tell();
    show();
  };
  const tell = () => {
    put(summary, "The arm", lacking(meant) ? `: ${lacking(meant)} of ${counted(meant.meshes.length, "mesh", "meshes")} missing` : "");
    put(meshes, meant.meshes.length ? meshesForm(meant, sent, signal) : null);
  };
  const summary = h("summary", {});
  const element = h("details", { id: "robot-picture", ontoggle: show }, summary, place, meshes);
  tell();
  return element;
}

function lacking({ meshes }) {
  return meshes.filter((one) => !one.sha256).length;
}

function meshesForm(robot, onSent, signal) {
  const said = h("div");
  const rows = robot.meshes.map((one) => h("li", {}, one.sha256 ? "✓ " : "missing: ", h("code", {}, one.name), ` of ${one.links.join(", ")}`));
  const send = async (files) => {
    if (!files.length) return void put(said, h("p", { class: "note" }, "There is no STL, OBJ, DAE or PLY file in it."));
    const given = givenUp(`Reading ${counted(files.length, "file")}`, said);
    signal.addEventListener("abort", given.stop);
    const form = new FormData();
    for (const file of files) form.append("files", file, pathOf(file));
    try {
      const answer = await ask("PUT", `/robots/${robot.id}/meshes`, { body: form, signal: given.signal });
      announce(lacking(answer) ? `${lacking(answer)} meshes are still missing` : "All meshes are here");
      onSent(answer);
    } catch (error) {
      if (error.name === "AbortError") put(said, h("p", { class: "note" }, "Given up; nothing was stored."));
      else put(said, problemBox(error, () => send(files)));
    }
  };
  const missing = lacking(robot);
  return h("div", {},
    h("p", { class: "note" }, missing ? `The description names meshes that are not here: ${missing} of ${robot.meshes.length}. Designs do not check these links for collision, and the picture has none of them.` : "All meshes of the description are here. They count for collisions in designs."),
    dropZone("Drop the folder of the meshes here, or choose their files:", { accept: ".stl,.obj,.dae,.ply", multiple: true, folders: true, id: "mesh-files" }, send),
    said,
    h("details", {}, h("summary", {}, "Which meshes"), h("ul", {}, rows)));
}

/** A file's name with its folders, as far as they are known. */
function pathOf(file) {
  return file.pathInFolder ?? (file.webkitRelativePath || file.name);
}
