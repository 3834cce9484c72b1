// A robot as described: the arm, and the upload of meshes that its description names.

import { ask } from "../api.js";
import { announce, h, put } from "../dom.js";
import { dropZone } from "../drop_zone.js";
import { counted } from "../format.js";
import { givenUp } from "../jobs.js";
import { problemBox } from "../problem.js";
import { armBeside } from "./arm_beside_figures.js";

/** A part of a page to be opened: the arm at zero, and a place for the files of its meshes. */
export function pictureOf(robot, signal) {
  const meshes = h("div");
  let meant = robot;
  const arm = armBeside({ robotId: robot.id, view: new EventTarget(), motion: () => [], props: { id: "robot-picture" } }, signal);
  const tell = () => {
    put(arm.element.firstChild, "Picture of the robot", lacking(meant) ? `: ${lacking(meant)} of ${counted(meant.meshes.length, "mesh", "meshes")} missing` : "");
    put(meshes, meant.meshes.length ? meshesForm(meant, sent, signal) : null);
  };
  const sent = (answer) => {
    meant = { ...meant, meshes: answer.meshes };
    tell();
    arm.forget();
  };
  arm.element.append(meshes);
  tell();
  return arm.element;
}

function lacking({ meshes }) {
  return meshes.filter((one) => !one.sha256).length;
}

function meshesForm(robot, onSent, signal) {
  const said = h("div");
  const rows = robot.meshes.map((one) => h("li", {}, one.sha256 ? "✓ " : "missing: ", h("code", {}, one.name), ` of ${one.links.join(", ")}`));
  const send = async (files) => {
    if (!files.length) return void put(said, h("p", { class: "note" }, "It contains no STL, OBJ, DAE or PLY file."));
    const given = givenUp(`Reading ${counted(files.length, "file")}`, said);
    signal.addEventListener("abort", given.stop);
    const form = new FormData();
    for (const file of files) form.append("files", file, pathOf(file));
    try {
      const answer = await ask("PUT", `/robots/${robot.id}/meshes`, { body: form, signal: given.signal });
      announce(lacking(answer) ? `${lacking(answer)} meshes are still missing` : "All meshes are uploaded");
      onSent(answer);
    } catch (error) {
      if (error.name === "AbortError") put(said, h("p", { class: "note" }, "Cancelled; nothing was stored."));
      else put(said, problemBox(error, () => send(files)));
    }
  };
  const missing = lacking(robot);
  return h("div", {},
    h("p", { class: "note" }, missing ? `${missing} of ${robot.meshes.length} meshes that the description names are missing. Designs do not check these links for collisions, and the picture does not show them.` : "All meshes of the description are uploaded. Designs check them for collisions."),
    dropZone("Drop the folder of the meshes here, or choose their files:", { accept: ".stl,.obj,.dae,.ply", multiple: true, folders: true, id: "mesh-files" }, send),
    said,
    h("details", {}, h("summary", {}, "Which meshes"), h("ul", {}, rows)));
}

/** A file's name with its folders, as far as they are known. */
function pathOf(file) {
  return file.pathInFolder ?? (file.webkitRelativePath || file.name);
}
