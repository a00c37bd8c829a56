// Runs npm's forge and ends with its status: `node contracts/forge.mjs test`.
// The package's own launcher ends with 0 whatever forge says, so a failing test would pass.
import { spawnSync } from "node:child_process";
import { createRequire } from "node:module";
import { argv, platform, arch } from "node:process";
import { fileURLToPath } from "node:url";

const ARCHITECTURES = { x64: "amd64", arm64: "arm64" };

/** The program itself, for tools that call it. */
export const program = createRequire(import.meta.url).resolve(
  `@foundry-rs/forge-${platform}-${ARCHITECTURES[arch]}/bin/forge${platform === "win32" ? ".exe" : ""}`,
);

/** Exit status of forge with these arguments, in the repository's root. */
export function forge(...args) {
  const { status, signal, error } = spawnSync(program, args, {
    cwd: fileURLToPath(new URL("..", import.meta.url)),
    stdio: "inherit",
  });
  if (error) throw error;
  if (signal) throw new Error(`forge was ended by ${signal}`);
  return status;
}

if (argv[1] === fileURLToPath(import.meta.url)) {
  process.exitCode = forge(...argv.slice(2));
}
