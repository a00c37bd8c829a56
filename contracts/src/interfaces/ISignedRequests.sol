// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId} from "../types/TaskId.sol";
import {TaskRequest} from "./ITaskManager.sol";

/// @notice The ruling that a challenge is against, so that it never meets another one.
/// @param judge the IDisputeJudge that has the case, and takes the stake
/// @param taskId whose ruling
/// @param attempt which attempt at it
/// @param instance whose ruling it is, counted from 0
/// @param reason why it is wrong, as people read it
struct ChallengeRequest {
    address judge;
    TaskId taskId;
    uint8 attempt;
    uint8 instance;
    string reason;
}

/// @title Calls of TaskManager, and challenges, that somebody else sends, and pays the gas for.
/// @notice The participant signs what it wants (EIP-712). Anybody sends it, and TaskManager treats the signer as the
/// caller: its allowance pays, its membership counts, it is the creator or the executor. A contract signs by ERC-1271.
/// A request that fails changes nothing and may be sent again until its `deadline`, in block time. Its `nonce` is any number that
/// the signer has neither used nor revoked; 256 neighbours share one word of storage.
interface ISignedRequests {
    /// @notice A task was registered by a request. Follows the events of the task.
    event RequestUsed(address indexed signer, uint256 indexed nonce, TaskId indexed taskId, address relayer);
    event RequestRevoked(address indexed signer, uint256 indexed nonce);

    error RequestExpired(uint256 deadline, uint256 time);
    /// @notice The signature is of somebody else, or of another request, organization or chain.
    error NotSignedBy(address signer);
    error NonceUsed(address signer, uint256 nonce);

    /// @notice Register the task that its creator signed. The creator, not the caller, pays the reward, and has
    /// approved TaskManager for it.
    /// @param request the task
    /// @param signature of RegisterTask: 65 bytes, or what the creator's contract takes for one
    /// @return taskId the number of the task, counted from 1
    function registerTaskFor(
        address creator,
        TaskRequest calldata request,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external returns (TaskId taskId);

    /// @notice Cancel the open task whose creator signed this. A task is cancelled once, so this uses up no nonce, as
    /// submitProofFor does not: an attempt has one proof. The signer can revoke the nonce.
    /// @param taskId an open task of the creator
    /// @param signature of CancelTask
    function cancelTaskFor(
        address creator,
        TaskId taskId,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external;

    /// @notice Accept the task, as its executor signed.
    /// @param taskId the task that the executor is assigned
    /// @param attempt the running attempt
    /// @param signature of AcceptTask
    function acceptTaskFor(
        address executor,
        TaskId taskId,
        uint8 attempt,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external;

    /// @notice Give the task back, as its executor signed. Whether that is free depends on when this is sent: a deadline
    /// within the grace period leaves no choice to the relayer.
    /// @param taskId the task that the executor is assigned
    /// @param attempt the running attempt
    /// @param signature of AbandonTask
    function abandonTaskFor(
        address executor,
        TaskId taskId,
        uint8 attempt,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external;

    /// @notice Submit the proof that the executor signed.
    /// @param taskId the task that the executor does
    /// @param attempt the running attempt
    /// @param proofHash SHA-256 of the recording
    /// @param uri where it can be fetched; only in the event
    /// @param signature of SubmitProof
    function submitProofFor(
        address executor,
        TaskId taskId,
        uint8 attempt,
        bytes32 proofHash,
        string calldata uri,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external;

    /// @notice Challenge a ruling, as a party to the task or a judge signed. The challenger, not the caller, pays the stake,
    /// and has approved the judge's contract for it.
    /// @param request the ruling, and the contract that is to hear this
    /// @param signature of Challenge
    function challengeFor(
        address challenger,
        ChallengeRequest calldata request,
        uint256 nonce,
        uint256 deadline,
        bytes calldata signature
    ) external;

    /// @notice The caller uses up a nonce, so that all requests with it are void, whatever they are about.
    /// @param nonce of the caller
    function revokeRequest(uint256 nonce) external;

    /// @notice Returns whether a request with this nonce was used or revoked.
    /// @param signer whose nonce
    /// @param nonce the number
    function isNonceUsed(address signer, uint256 nonce) external view returns (bool);
}
