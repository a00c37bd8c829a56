// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId} from "../types/TaskId.sol";
import {Fault, ITaskManager, Ruling} from "./ITaskManager.sol";

/// @notice A judge's finding, which it signs where several have to agree (EIP-712): all but where its report lies.
/// @param taskId which task,
/// @param attempt which attempt at it
/// @param proofHash SHA-256 of the proof that was judged
/// @param reportHash SHA-256 of the report; judges whose reports differ in one number do not agree
/// @param rulesHash SHA-256 of the rules that were applied
/// @param ruling what the judge says; None: it cannot decide, and passes the case on
/// @param fault whose fault a void is
/// @param amount what an accepted proof is paid, in the token's smallest unit
/// @param reason why, as people read it
struct Finding {
    TaskId taskId;
    uint8 attempt;
    bytes32 proofHash;
    bytes32 reportHash;
    bytes32 rulesHash;
    Ruling ruling;
    Fault fault;
    uint96 amount;
    string reason;
}

/// @title Who rules on the proofs of a kind.
/// @notice The organization names one for each kind (IOrganization.allowKind). It rules by ITaskManager.rule, as often as the
/// case allows, and says in words why. The task manager never calls it.
interface IJudge {
    /// @notice In the transaction of each ruling, whose event ITaskManager.Ruled has the attempt and the report's hash.
    event Reported(TaskId indexed taskId, string reportUri, string reason);
    /// @notice It cannot decide: `next` may, until the case ends.
    event PassedOn(TaskId indexed taskId, uint8 attempt, address next);

    error NotNext(address caller, address next);
    error NotPassedOn(TaskId taskId, uint8 attempt);
    /// @notice A judge does not decide what it has passed on.
    error PassedOnBefore(TaskId taskId, uint8 attempt);
    /// @notice There is nobody to pass it on to.
    error MustRule(TaskId taskId);
    /// @notice Neither the creator nor the executor judges, nor whoever owns one of them or has the same owner.
    error JudgeIsParty(TaskId taskId, address account);
    /// @notice An auditor decides nothing that itself, its owner or a device of the same owner has passed on.
    error JudgeIsAuditor(TaskId taskId, address account);
    /// @notice A judge that was removed may need so much to answer, and the caller left less.
    error TooLittleGas(uint256 needed);
    error NotAdministrator(address account);

    function tasks() external view returns (ITaskManager);

    /// @notice Returns the instance that decides what this one passes on; 0 if there is none.
    function next() external view returns (address);

    /// @notice Returns whether `account` was among those who passed on the task's last attempt that was passed on, or has the
    /// same owner as one of them. It decides nothing of it.
    /// @param account who wants to decide it
    function hasPassedOn(TaskId taskId, address account) external view returns (bool);

    /// @notice Asked once for each kind, by IOrganization.allowKind, with a gas limit.
    /// @param kind what is done, ASCII
    /// @return magic the selector of this function, if it judges this kind
    /// @return minVerdictWindow the shortest verdict window in which it answers, s
    /// @return maxCase the longest case that it takes, verdict and audit window together, s
    function termsFor(bytes32 kind)
        external
        view
        returns (bytes4 magic, uint32 minVerdictWindow, uint32 maxCase);

    /// @notice Rule on what this judge has passed on. Only its `next`.
    /// @param finding what `next` found
    /// @param reportUri where its report lies
    function ruleForNext(Finding calldata finding, string calldata reportUri) external;
}
