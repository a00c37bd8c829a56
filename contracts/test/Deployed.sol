// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {CommonBase} from "forge-std/Base.sol";

/// @notice The contracts as Python deploys them: from the committed artifacts, which are compiled with `via_ir`. With
/// `RODEO_CONTRACTS=sources` they are made from the sources as they are, so that planted bugs and coverage show.
/// @dev `contracts/forge.mjs` refuses to test artifacts that do not match the sources.
abstract contract Deployed is CommonBase {
    /// @return A contract that this one creates now.
    function deployed(string memory name, bytes memory arguments) internal returns (address) {
        return vm.deployCode(artifactOf(name), arguments);
    }

    function deployed(string memory name) internal returns (address) {
        return deployed(name, "");
    }

    /// @return Its init code without arguments.
    function codeOf(string memory name) internal view returns (bytes memory) {
        return vm.getCode(artifactOf(name));
    }

    /// @return What the cheat codes that read artifacts call it.
    function artifactOf(string memory name) internal view returns (string memory) {
        if (keccak256(bytes(vm.envOr("RODEO_CONTRACTS", string("")))) == keccak256("sources")) {
            return string.concat(name, ".sol:", name);
        }
        return string.concat("rodeo/chain/artifacts/", name, ".json");
    }
}
