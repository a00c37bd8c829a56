// Runs npm's forge and ends with its status: `node contracts/forge.mjs test`.
// The package's own launcher ends with 0 whatever forge says, so a failing test would pass.
//
// Tests run what is deployed (contracts/test/Deployed.sol), and do not begin if that does not match the sources.
// With RODEO_CONTRACTS=sources, and for coverage, they run the sources as they are.
import { spawnSync } from "node:child_process";
import { createRequire } from "node:module";
import { argv, env, platform, arch } from "node:process";
import { fileURLToPath } from "node:url";
import { changes } from "./built.mjs";

const ARCHITECTURES = { x64: "amd64", arm64: "arm64" };
const root = fileURLToPath(new URL("..", import.meta.url));

/** The program itself, for tools that call it. */
export const program = createRequire(import.meta.url).resolve(
  `@foundry-rs/forge-${platform}-${ARCHITECTURES[arch]}/bin/forge${platform === "win32" ? ".exe" : ""}`,
);

/** Exit status of forge with these arguments, in the repository's root. */
export function forge(...args) {
  const { status, signal, error } = spawnSync(program, args, { cwd: root, stdio: "inherit" });
  if (error) throw error;
  if (signal) throw new Error(`forge was ended by ${signal}`);
  return status;
}

/** Whether tests of the built contracts are tests of these sources; says what to do if not. */
function matches() {
  const changed = changes(root, program);
  if (changed.length === 0) return true;
  console.error(
    "The built contracts do not match the sources, so tests of them would tell nothing. Changed since they were built:\n" +
      changed.map((one) => `  ${one}\n`).join("") +
      "Build them with `make contracts`, or test the sources as they are: RODEO_CONTRACTS=sources npm run contracts:test",
  );
  return false;
}

if (argv[1] === fileURLToPath(import.meta.url)) {
  const args = argv.slice(2);
  if (args[0] === "coverage") env.RODEO_CONTRACTS = "sources";
  const built = args[0] === "test" && env.RODEO_CONTRACTS !== "sources";
  process.exitCode = built && !matches() ? 1 : forge(...args);
}
