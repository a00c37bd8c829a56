// What the built contracts were built from, without compiling: the compiler's version, its settings, and a hash of each
// source. A hash of what was built is with them, so that no contract is left from before.
import { spawnSync } from "node:child_process";
import { createHash } from "node:crypto";
import { existsSync, readFileSync } from "node:fs";
import { join } from "node:path";

// Besides the sources, what may change the code that the compiler makes.
const SETTINGS = [
  ...["solc", "evm_version", "via_ir", "optimizer", "optimizer_runs", "optimizer_details", "bytecode_hash"],
  ...["cbor_metadata", "revert_strings", "libraries", "remappings", "additional_compiler_profiles"],
];

/** The file that the build writes beside the contracts. */
export const origin = (root) => join(root, "rodeo", "chain", "artifacts", "origin.json");

function hash(path) {
  return createHash("sha256").update(readFileSync(path)).digest("hex");
}

/** The same of now, for this program of forge and these files. */
export function current(root, program, files) {
  const env = { ...process.env, FOUNDRY_PROFILE: "deploy" };
  const { status, stdout, stderr } = spawnSync(program, ["config", "--json"], { cwd: root, env, encoding: "utf8" });
  if (status !== 0) throw new Error(`forge config ended with ${status}: ${stderr}`);
  const config = JSON.parse(stdout);
  const compiler = JSON.parse(readFileSync(join(root, "node_modules", "solc", "package.json"), "utf8"));
  return {
    compiler: compiler.version,
    settings: Object.fromEntries(SETTINGS.map((name) => [name, config[name] ?? null])),
    files: Object.fromEntries(files.map((path) => [path, existsSync(join(root, path)) ? hash(join(root, path)) : null])),
  };
}

/** What has changed since the contracts were built: paths of files, names of settings, "compiler". */
export function changes(root, program) {
  if (!existsSync(origin(root))) return [origin(root)];
  const then = JSON.parse(readFileSync(origin(root), "utf8"));
  // A source that is new is imported by one that has changed.
  const now = current(root, program, Object.keys(then.files));
  const differ = (part) =>
    Object.keys(now[part]).filter((name) => JSON.stringify(now[part][name]) !== JSON.stringify(then[part][name]));
  return [...(now.compiler === then.compiler ? [] : ["compiler"]), ...differ("settings"), ...differ("files")];
}
