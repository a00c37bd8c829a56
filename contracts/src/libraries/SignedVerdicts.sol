// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ECDSA} from "@openzeppelin/contracts/utils/cryptography/ECDSA.sol";
import {MessageHashUtils} from "@openzeppelin/contracts/utils/cryptography/MessageHashUtils.sol";
import {Vote} from "../interfaces/ITaskManager.sol";

/// @title What a judge signs (EIP-712) for an executor who hands in the verdict together with the proof.
library SignedVerdicts {
    bytes32 private constant DOMAIN_TYPEHASH =
        keccak256("EIP712Domain(string name,string version,uint256 chainId,address verifyingContract)");
    bytes32 private constant NAME = keccak256("RODEO TaskManager");
    bytes32 private constant VERSION = keccak256("1");
    bytes32 private constant TYPEHASH = keccak256(
        "SignedVerdict(uint256 taskId,uint8 attempt,bytes32 proofHash,bytes32 reportHash,bytes32 rulesHash,"
        "uint8 verdict,uint256 amount,string reason,address judge,uint256 deadline)"
    );
    /// @dev r, and s with its parity: EIP-2098.
    uint256 private constant SIGNATURE_BYTES = 64;

    /// @notice Returns what is signed, of this chain and one TaskManager alone.
    /// @param vote the verdict
    /// @param judge the account that signs, or the committee whose judges do
    /// @param deadline until when it can be used, block time in seconds
    /// @param tasks the TaskManager
    function digestOf(Vote memory vote, address judge, uint256 deadline, address tasks)
        internal
        view
        returns (bytes32)
    {
        bytes32 domain = keccak256(abi.encode(DOMAIN_TYPEHASH, NAME, VERSION, block.chainid, tasks));
        bytes32 content = keccak256(
            abi.encode(
                TYPEHASH,
                vote.taskId,
                vote.attempt,
                vote.proofHash,
                vote.reportHash,
                vote.rulesHash,
                vote.verdict,
                vote.amount,
                keccak256(bytes(vote.reason)),
                judge,
                deadline
            )
        );
        return MessageHashUtils.toTypedDataHash(domain, content);
    }

    /// @notice Returns whether this account signed `digest`.
    /// @param account who should have
    /// @param digest what should be signed
    /// @param signature 64 bytes (EIP-2098); any other length is signed by nobody
    function isSignedBy(address account, bytes32 digest, bytes calldata signature)
        internal
        pure
        returns (bool)
    {
        if (signature.length != SIGNATURE_BYTES) return false;
        // slither-disable-next-line unused-return
        (address signer, ECDSA.RecoverError failure,) =
            ECDSA.tryRecover(digest, bytes32(signature[:32]), bytes32(signature[32:]));
        return failure == ECDSA.RecoverError.NoError && signer == account;
    }
}
