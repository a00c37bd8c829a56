// Has a solver look for values that break an assertion of contracts/symbolic, in all paths of the contracts' code:
//   node contracts/symbolic.mjs
// It is given whole amounts, bonds and penalties as unknowns, where a fuzzer tries some.
import { spawnSync } from "node:child_process";
import { delimiter, dirname, join } from "node:path";
import { argv } from "node:process";
import { fileURLToPath } from "node:url";
import { program } from "./forge.mjs";

const root = dirname(dirname(fileURLToPath(import.meta.url)));
const halmos = join(root, ".venv-symbolic", "bin", "halmos");

/** Exit status of halmos, of the contracts in this directory. */
export function symbolic(directory, options = {}) {
  const { status, stdout, signal, error } = spawnSync(
    halmos,
    // A path that the solver does not end in time counts as a failure.
    ["--root", directory, "--forge-build-out", "contracts/out/symbolic", "--no-status", "--solver-timeout-assertion", "120s"],
    {
      cwd: directory,
      env: {
        ...process.env,
        FOUNDRY_PROFILE: "symbolic",
        // The launcher of npm's package, which halmos would find otherwise, ends with 0 whatever forge says.
        PATH: dirname(program) + delimiter + process.env.PATH,
      },
      ...options,
    },
  );
  if (error) throw error;
  if (signal) throw new Error(`halmos was ended by ${signal}`);
  return { status, stdout };
}

if (argv[1] === fileURLToPath(import.meta.url)) {
  process.exitCode = symbolic(root, { stdio: "inherit" }).status;
}
