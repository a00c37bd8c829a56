// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Vote} from "./ITaskManager.sol";

/// @title A contract that judges by the votes of several keys.
interface IVoteCounter {
    /// @notice Reverts unless enough of its judges, who may all judge the submitted proof, have signed the verdict. Only
    /// the task manager, and a contract that itself may judge the kind (Disputes).
    /// @param vote the verdict
    /// @param digest what they signed; see SignedVerdicts, or IOracleCommittee.digestOf
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    /// @return this function's selector, which a contract that only takes every call does not return
    function countVotes(Vote calldata vote, bytes32 digest, bytes calldata signatures)
        external
        returns (bytes4);
}
