// What the page has where no server stands behind it: other devices, the simulator's studies, a link that restores all.
import { BOARD, link } from "./connect.js";
import { address, read } from "./address.js";
import { Restored, told } from "./settings.js";
import { Studies } from "./studies.js";

const NAMES = ["nucleo-f446re", "discovery-f407", "paper-1um", "paper-2um", "epfl-paddle", "rice-paddle", "hapkit", "smartknob"];
const LIMIT = 1 << 20; // bytes of a scene file, as `cargo sim` has it

const by = (id) => document.getElementById(id);
const make = (name, more = {}, ...inside) => {
  const item = Object.assign(document.createElement(name), more);
  item.append(...inside);
  return item;
};

const style = make("link", { rel: "stylesheet", href: new URL("web.css", import.meta.url) });
document.head.append(style);
if (window !== window.top) document.documentElement.classList.add("embedded");

// The device.
const names = make("select", { id: "scene" }, ...NAMES.map((name) => new Option(name)));
const file = make("input", { type: "file", id: "file", accept: ".toml", hidden: true });
const open = make("button", { id: "open", title: "a scene file; it stays in this browser" }, "File …");
const share = make("button", { id: "share", title: "restores device and settings; a file's text is in it" }, "Copy link");
const runs = make("select", { id: "runs", title: "the release ELF on an emulated chip, or the same library in the simulator's loop" },
  new Option("release ELF", "elf"), new Option("core, no chip", "core"));
const quick = make("button", { id: "quick" }, "Core, real time");
const slowly = make("span");
const slow = make("p", { id: "slow", hidden: true }, slowly, " ", quick);
const wrong = make("p", { id: "wrong", className: "bad", hidden: true });
wrong.role = "alert";
by("left").prepend(make("fieldset", { id: "device" }, make("legend", {}, "Device"),
  make("label", {}, "scene ", names), make("label", {}, "runs ", runs), make("div", { className: "row" }, open, share, file), wrong, slow));

function say(text) {
  wrong.hidden = !text;
  wrong.textContent = text;
}

const studies = new Studies(link, make);
by("left").append(studies.panel);

const restored = new Restored(link, say);
const files = new Map(); // that were dropped, by what the list calls them: no file is taken for a scene of this page
const listed = ({ scene, text }) => text === undefined ? scene : `file ${scene}`;
let takes = 0;

// Another device, with settings that are put in when it runs. What is wrong with it is said, and the one before stays. What
// no board can be, the core still may; what neither can be, the simulator's studies are of. Of two that overlap
// the later counts; whether this one did.
async function take({ core = false, ...device }, settings = null) {
  const problems = [], number = ++takes;
  const isWanted = () => number === takes;
  const tried = (what) => what.then(() => true, (error) => { problems.push(error.message); return false; });
  say("");
  const known = await tried(link.pool.ask({ ask: "scene", ...device }, "scene"));
  const start = (...what) => isWanted() && tried(link.start(...what, isWanted));
  const runs = known && (await start(device, core) || !core && await start(device, true));
  if (runs) restored.want(settings);
  if (!link.scene) await start({ scene: BOARD }, false);
  if (!isWanted()) return false;
  if (!link.scene) return say(problems.join(" "));
  const name = listed(link.scene);
  if (![...names.options].some(({ value }) => value === name)) names.add(new Option(name));
  if (link.scene.text !== undefined) files.set(name, link.scene);
  names.value = name;
  by("runs").value = link.core ? "core" : "elf";
  slow.hidden = true;
  studies.take(known && !runs ? device : link.scene);
  if (problems.length) say(known && !runs ? `${problems.at(-1)}. The simulator's studies are of ${device.scene} now, the board is not.` :
    runs ? `${problems[0]}. It runs without a chip.` : problems[0]);
  return true;
}

async function takeFile(given) {
  if (!given) return;
  if (given.size > LIMIT) return say(`${given.name} is larger than a scene may be, allowed 1 MiB`);
  let bytes, text;
  try {
    bytes = await given.arrayBuffer();
  } catch (error) {
    return say(`${given.name} cannot be read: ${error.message}`);
  }
  try {
    text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    return say(`${given.name} is not UTF-8 text`);
  }
  return take({ scene: given.name, text, core: runs.value === "core" });
}

names.onchange = () => take({ ...files.get(names.value) ?? { scene: names.value }, core: runs.value === "core" });
runs.onchange = () => take({ ...link.scene, core: runs.value === "core" }, held());
quick.onclick = () => take({ ...link.scene, core: true }, held());

// The settings in force, for the next board.
function held() {
  const text = window.zwidth.state?.settings;
  return restored.wanted ?? (text ? told(text) : {});
}
open.onclick = () => file.click();
file.onchange = () => { takeFile(file.files[0]); file.value = ""; };
window.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
window.addEventListener("dragleave", () => document.body.classList.remove("over"));
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  takeFile(event.dataTransfer.files[0]);
});

share.onclick = async () => {
  const text = await address(link.scene, link.core, held());
  history.replaceState(null, "", text);
  try {
    await navigator.clipboard.writeText(location.href);
    share.textContent = "Copied";
  } catch {
    share.textContent = "In the address bar";
  }
  setTimeout(() => { share.textContent = "Copy link"; }, 2000);
};
async function restore() {
  try {
    const { scene, settings } = await read(location.hash);
    await take(scene, settings);
  } catch (error) {
    if (await take({ scene: BOARD })) say(`the link: ${error.message}`);
  }
}
window.addEventListener("hashchange", restore);

// How fast it is, and whether anybody looks.
link.on("speed", (speed) => {
  slow.hidden = speed > .95;
  slowly.textContent = `This tab is slower than real time: ${speed.toFixed(2)} virtual seconds a second.`;
  quick.hidden = link.core;
  slow.dataset.speed = speed;
});
let [visible, inView] = [true, true];
const look = () => link.hide(!visible || !inView);
document.addEventListener("visibilitychange", () => { visible = document.visibilityState === "visible"; look(); });
new IntersectionObserver(([{ isIntersecting }]) => { inView = isIntersecting; look(); }).observe(document.body);

// From the second visit on without a network. After the first picture: what comes first is that.
link.on("curves", function register() {
  if (register.done) return;
  register.done = true;
  performance.mark("first picture");
  navigator.serviceWorker?.register(new URL("../sw.js", import.meta.url)).catch(() => {}); // not from a plain http host
});

window.zwidth.web = { take, takeFile, studies, link, pool: link.pool };
restore();
