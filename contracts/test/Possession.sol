// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Vm} from "forge-std/Vm.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";

/// @notice Registers devices whose keys are those of `makeAddr`.
library Possession {
    Vm private constant VM = Vm(address(uint160(uint256(keccak256("hevm cheat code")))));

    /// @dev As whoever is pranked; with the first signature of the key.
    function register(IOrganization organization, address device, bytes32 role, address owner, bytes32 name)
        internal
    {
        (bytes32 r, bytes32 vs) = sign(registryOf(organization), block.chainid, device, owner, 0);
        organization.registerDevice(device, role, owner, name, r, vs);
    }

    /// @dev Where its constructor makes it: asking would use up a prank.
    function registryOf(IOrganization organization) internal pure returns (address) {
        return VM.computeCreateAddress(address(organization), 1);
    }

    function sign(address registry, uint256 chainId, address device, address owner, uint256 nonce)
        internal
        pure
        returns (bytes32 r, bytes32 vs)
    {
        return VM.signCompact(keyOf(device), digest(registry, chainId, device, owner, nonce));
    }

    function digest(address registry, uint256 chainId, address device, address owner, uint256 nonce)
        internal
        pure
        returns (bytes32)
    {
        bytes32 domain = keccak256(
            abi.encode(
                keccak256(
                    "EIP712Domain(string name,string version,uint256 chainId,address verifyingContract)"
                ),
                keccak256("RODEO DeviceRegistry"),
                keccak256("1"),
                chainId,
                registry
            )
        );
        bytes32 typehash = keccak256("Possession(address device,address owner,uint256 nonce)");
        bytes32 said = keccak256(abi.encode(typehash, device, owner, nonce));
        return keccak256(abi.encodePacked("\x19\x01", domain, said));
    }

    /// @dev Of those that the tests use; another one's signature is of nobody.
    function keyOf(address device) internal pure returns (uint256) {
        string[9] memory names =
            ["robot1", "robot2", "robot3", "alice", "bob", "stranger", "device", "bin", "next"];
        for (uint256 i = 0; i < names.length; ++i) {
            uint256 key = uint256(keccak256(bytes(names[i])));
            if (VM.addr(key) == device) return key;
        }
        return 1;
    }
}
