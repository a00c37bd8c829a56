// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {KindId} from "../types/KindId.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";
import {IServiceListener} from "./IServiceListener.sol";
import {Hire} from "./IServiceManager.sol";
import {Cause, ITaskQueues} from "./ITaskQueues.sol";

/// @dev The part of the price that an executor is paid for a task that is impossible: one in so many.
uint256 constant IMPOSSIBLE_SHARE = 10;

/// @notice Ruled: a ruling on the proof stands until its time is over, and another one may replace it.
enum TaskState {
    None,
    Open,
    Assigned,
    Submitted,
    Ruled,
    Settled,
    Cancelled,
    Failed
}

/// @notice A judge says one of five things of a proof.
/// Accepted: the work was done, and is paid.
/// Rejected: the executor claims what is not so. It pays the penalty, and its record says so.
/// GivenUp: the executor could not do it. It is not paid, and pays nothing.
/// Impossible: nobody could do this task. It ends, and the executor is paid a part of the price for its trouble.
/// Void: nobody's doing, or not to be told. The task ends without a payment, and nobody pays.
enum Ruling {
    None,
    Accepted,
    Rejected,
    GivenUp,
    Impossible,
    Void
}

/// @notice The party at fault for a void. The executor's fault is GivenUp or Rejected.
/// CreatorsWitness: a device whose owner is the creator. Oracle: it was silent, or its own machine failed.
enum Fault {
    Nobody,
    Creator,
    CreatorsWitness,
    OtherWitness,
    Oracle
}

/// @param kind what is to be done, ASCII
/// @param reward the most it may cost, in the token's smallest unit; all of it goes to escrow
/// @param executionWindow seconds from assignment to proof
/// @param verdictWindow seconds from proof to verdict
/// @param maxAttempts how many assignments before the reward goes back
/// @param rules SHA-256 of the rules by which it is to be judged, so that none that came meanwhile surprises the
/// creator; 0 for the newest that are current. See IOrganization.allowKind.
/// @param serviceId the only service that may do it, at its own price; 0 if it names none
/// @param provider the only provider whose services of this kind may do it, each at its own price; 0 if it names none.
/// A task that names neither goes to whichever service the policy chooses
/// @param params JSON; only in the event
struct TaskRequest {
    bytes32 kind;
    uint256 reward;
    uint32 executionWindow;
    uint32 verdictWindow;
    uint8 maxAttempts;
    bytes32 rules;
    uint32 serviceId;
    address provider;
    string params;
}

/// @param kindId the number of its kind and judge, see IOrganization.numberOf
/// @param price what the executor of the running (or last) attempt is paid at most
/// @param serviceId the service of the running (or last) attempt; while open the one that the task names, or 0
/// @param provider the provider that the task names; 0 if it names none
/// @param deadline end of the running window, block time in seconds; 0 when none runs. The proof came `verdictWindow` before that
/// of a task that is Submitted or Ruled
/// @param caseEnd until then a ruling can be made or replaced; 0 unless Submitted or Ruled
/// @param attempt 1 for the first assignment
/// @param accepted the executor of the running (or last) attempt agreed to it; see acceptTask
/// @param hired whether the creator named the service, or the provider
/// @param proofHash SHA-256 of the proof that waits for its ruling, or has one that stands; 0 unless Submitted or Ruled, earlier ones
/// are in events
struct Task {
    address creator;
    uint96 reward;
    KindId kindId;
    uint96 price;
    ServiceId serviceId;
    address provider;
    uint32 executionWindow;
    uint32 verdictWindow;
    uint40 deadline;
    uint40 caseEnd;
    uint8 attempt;
    uint8 maxAttempts;
    TaskState state;
    bool accepted;
    Hire hired;
    bytes32 proofHash;
}

/// @notice What a judge learns of an attempt as it rules.
/// @param ruled whether a ruling stood before
struct Judged {
    address creator;
    address provider;
    KindId kindId;
    uint40 submitted;
    bool ruled;
}

/// @notice A ruling that stands.
/// @param proofHash the proof that it is about
/// @param amount what it pays
/// @param until when it can be concluded, unless it is replaced before; block time in seconds
/// @param penalty what was set aside of the bond until the case ends
/// @param afterRemoval it was made after the organization took the judge's right away
struct Standing {
    bytes32 proofHash;
    Ruling ruling;
    uint96 amount;
    uint40 until;
    uint96 penalty;
    bool afterRemoval;
}

/// @title Tasks and their escrow.
/// @notice
///     Open ──match──> Assigned ──proof──> Submitted ──ruling──> Ruled ──conclude──> Settled
///      │ ^               │                    │   └─── final ruling ──────────────────^
///      │ └───────────────┴── expired, rejected, given up ┴──────────────┘ (Failed at the last, or void)
///      └──> Cancelled
/// The whole reward is held from registration to one of the three terminal states, in which the executor has what the
/// ruling gave it and the creator the rest. The contract holds the bonds of services as well; whatever else it is sent
/// can be rescued. Where nobody rules, nobody is paid: the attempt is void. While a ruling stands, the service is free,
/// and only the penalty is set aside of its bond. After Open every state has an exit that anybody can take.
interface ITaskManager is IServiceListener {
    /// @param rules by which it is judged until it ends, whatever becomes current later; 0 where people judge and no
    /// rules were named. Only in the event: no contract decides by them.
    event TaskRegistered(
        TaskId indexed taskId,
        address indexed creator,
        bytes32 indexed kind,
        uint256 reward,
        uint32 executionWindow,
        uint32 verdictWindow,
        uint8 maxAttempts,
        bytes32 rules,
        string params
    );
    /// @notice Follows TaskRegistered where the creator named a service.
    event ServiceRequested(TaskId indexed taskId, ServiceId indexed serviceId);
    /// @notice Follows TaskRegistered where the creator named a provider.
    event ProviderRequested(TaskId indexed taskId, address indexed provider);
    /// @param nonce could not be known before this assignment; a proof has to contain it
    event TaskAssigned(
        TaskId indexed taskId,
        uint8 attempt,
        address indexed executor,
        ServiceId indexed serviceId,
        uint256 price,
        bytes32 nonce,
        uint256 deadline
    );
    event ProofSubmitted(
        TaskId indexed taskId, uint8 attempt, address indexed executor, bytes32 indexed proofHash, string uri
    );
    /// @notice The judge says it in words in its own event of the same transaction, IJudge.Reported.
    /// @param fault of a void; Nobody of another ruling, whatever the judge says
    /// @param until the ruling stands until then and may be replaced; 0 if it is final
    /// @param report SHA-256 of the report; 0 where nobody has ruled
    event Ruled(
        TaskId indexed taskId,
        uint8 attempt,
        bytes32 indexed proofHash,
        Ruling ruling,
        Fault fault,
        uint256 amount,
        uint256 until,
        bytes32 report
    );
    /// @param payout who is paid: the executor, or whom it has named (IServiceManager.setPayout)
    /// @param refund the rest of the reward, which the creator has back
    event TaskSettled(TaskId indexed taskId, address indexed payout, uint256 paid, uint256 refund);
    /// @param attempt the attempt that failed
    event TaskRequeued(TaskId indexed taskId, uint8 attempt, Cause cause);
    /// @param attempt the last attempt, which failed
    event TaskFailed(TaskId indexed taskId, uint256 refund, uint8 attempt, Cause cause);
    /// @notice The executor agreed to this attempt by a call. A service with `autoAccept` agrees when it is assigned.
    event TaskAccepted(TaskId indexed taskId, uint8 attempt, address indexed executor);
    event TaskCancelled(TaskId indexed taskId, uint256 refund);
    /// @notice The organization's policy reverted or chose an unfit service, and the task waits (see matchTask); or a service
    /// became free, the policy reverted or chose an unfit task for it, and this one, the oldest, took that one's place.
    event PolicyFailed(TaskId indexed taskId);
    /// @notice The token refused the transfer, or wanted more gas than Payments.GAS; the amount is kept until
    /// `withdrawPayments`, so that it holds up nobody else.
    event PaymentDeferred(address indexed account, uint256 amount);
    event PaymentCollected(address indexed account, uint256 amount);

    /// @notice The executor, or its service for each task, has accepted this attempt before.
    error AlreadyAccepted(TaskId taskId, uint8 attempt);
    error UnknownTask(TaskId taskId);
    error WrongState(TaskId taskId, TaskState current, TaskState expected);
    error WrongAttempt(TaskId taskId, uint8 current, uint8 given);
    error NotCreator(TaskId taskId, address caller, address creator);
    error NotExecutor(TaskId taskId, address caller, address executor);
    /// @notice Another contract judges work of this kind. See IOrganization.allowKind.
    error NotJudge(address caller, KindId kindId);
    error NoRuling(TaskId taskId);
    /// @notice Accepted work is paid more than nothing and at most its price, other rulings pay nothing.
    error InvalidAmount(TaskId taskId, uint256 amount, uint256 max);
    /// @notice A ruling stands from now on, and no longer than its case.
    error InvalidUntil(TaskId taskId, uint256 until, uint256 caseEnd);
    error CaseOver(TaskId taskId, uint256 caseEnd, uint256 time);
    /// @notice The ruling may still be replaced.
    error RulingStands(TaskId taskId, uint256 until, uint256 time);
    error NotServiceManager(address caller);
    error NotOrganization(address caller);
    /// @notice matchTask named a service that is not free, does other work, is too dear, has had the task before or is not
    /// proven where only proven providers are offered it; or the task names another one.
    error ServiceDoesNotFit(TaskId taskId, ServiceId serviceId);
    error InvalidAttempts(uint8 attempts, uint8 max);
    error NothingOwed(address account);
    /// @notice The token took a fee, or moved nothing: escrow must hold what it owes.
    error WrongAmountReceived(uint256 expected, uint256 received);
    error EmptyProof(TaskId taskId);
    error ProofMismatch(TaskId taskId, bytes32 submitted, bytes32 given);
    error DeadlinePassed(TaskId taskId, uint256 deadline, uint256 time);
    error DeadlineNotPassed(TaskId taskId, uint256 deadline, uint256 time);
    /// @notice The three contracts do not name each other.
    error NotWired(address organization, address services);

    /// @notice Register a task, and pay its reward into escrow. The policy's service is assigned at once, if there is
    /// one. A task that names a service or a provider waits for that one instead; its creator may cancel it meanwhile.
    /// @param request the task; the caller approves this contract for its reward before
    /// @return taskId the number of the task, counted from 1
    function registerTask(TaskRequest calldata request) external returns (TaskId taskId);

    /// @notice The creator cancels an open task, and gets the whole reward back.
    /// @param taskId an open task of the caller
    function cancelTask(TaskId taskId) external;

    /// @notice The executor agrees to do the assigned task. If it then delivers no proof in time, or a judge rejects
    /// its proof, it pays the penalty of its terms. A proof accepts, too. Services with `autoAccept` need no call.
    /// @param taskId an assigned task
    /// @param attempt the running attempt
    function acceptTask(TaskId taskId, uint8 attempt) external;

    /// @notice The executor gives the assigned task back, and the attempt ends. In the grace period, which is the kind's,
    /// and before it has accepted, this costs a proven provider nothing, and the attempt does not count; a provider that is
    /// not proven rests. Later it counts as an attempt without a proof, and costs the penalty, but puts no proven provider to
    /// sleep. A task that named the executor, and would be offered to nobody else, ends with an attempt that does not count.
    /// @param taskId an assigned task
    /// @param attempt the running attempt
    function abandonTask(TaskId taskId, uint8 attempt) external;

    /// @notice The executor submits the hash of its proof, once in each attempt, in the execution window.
    /// @param taskId the task that the caller does
    /// @param attempt the running attempt
    /// @param proofHash SHA-256 of the recording
    /// @param uri where it can be fetched; only in the event
    function submitProof(TaskId taskId, uint8 attempt, bytes32 proofHash, string calldata uri) external;

    /// @notice The task's judge rules on the proof, from its submission to the end of the case: the verdict window and,
    /// after it, the audit window. Only the judge that the organization had for the kind when the task was posted; if
    /// it has lost that right, the organization's auditors.
    /// @param attempt the attempt that was judged
    /// @param proofHash the proof that was judged
    /// @param ruling what the judge says
    /// @param fault whose fault a void is
    /// @param amount what the executor is paid if the proof is accepted, at most the price; otherwise 0
    /// @param until 0: final now. Else it stands until then, and the judge may replace it
    /// @param report SHA-256 of the report
    /// @return judged the attempt as it was before this ruling
    function rule(
        TaskId taskId,
        uint8 attempt,
        bytes32 proofHash,
        Ruling ruling,
        Fault fault,
        uint96 amount,
        uint40 until,
        bytes32 report
    ) external returns (Judged memory judged);

    /// @notice Anyone does what the ruling says that stands, after its time, whenever that is. A proof on which nobody
    /// ruled in the verdict window is void until the case ends, and so is what a judge said that was removed.
    /// @param taskId a task that is submitted or ruled
    function conclude(TaskId taskId) external;

    /// @notice Anyone ends an attempt whose execution window has passed, or that its executor did not accept in the
    /// grace period. The task queues again, or fails and its creator is refunded.
    function expireTask(TaskId taskId) external;

    /// @notice Anyone gives an open task to a service that fits: it is free, affordable, and has not had the task before. What
    /// a match overlooks, which looks at a few services and tasks only, meets by this; so do a task that only proven providers
    /// are offered, and none of them took in an hour, and a service of any other provider.
    /// @param taskId an open task
    /// @param serviceId the service; 0 to ask the policy again, which is useful after PolicyFailed
    function matchTask(TaskId taskId, ServiceId serviceId) external;

    /// @notice Returns the ruling that stands; all zero unless the task is Ruled.
    function standing(TaskId taskId) external view returns (Standing memory);

    /// @notice Returns a task as it is now. Reverts with UnknownTask.
    function task(TaskId taskId) external view returns (Task memory);

    /// @notice Anyone has the amount paid that the token refused to transfer before. The account's payout address gets
    /// it, so that an account that the token refuses permanently can name another one (IServiceManager.setPayout).
    /// @param account who is owed something
    function withdrawPayments(address account) external;

    /// @notice Returns the amount that the token refused to transfer.
    /// @param account who is owed it
    function pendingPayments(address account) external view returns (uint256);

    /// @notice Returns the trusted forwarder: it says for whom it calls, and has verified that participant's signature.
    function signedRequests() external view returns (address);

    /// @notice Returns where open tasks wait, and which providers each of them has passed.
    function queues() external view returns (ITaskQueues);

    /// @notice Returns what this contract owes, in the token's smallest unit: rewards of live tasks, bonds and `pendingPayments`.
    function held() external view returns (uint256);

    /// @notice Read IOrganization.admission again. The organization calls this whenever it changes. Anybody may: after a pause
    /// has ended by time, new tasks cost 2,100 gas more until somebody does.
    function updateAdmission() external;

    /// @notice Name the judge of tasks with this number, and what their attempts count at most. Only the organization, with the
    /// same judge for each number.
    /// @param judge the contract that rules
    /// @param referencePrice see IOrganization.setWindows
    function recordJudge(KindId kindId, address judge, uint96 referencePrice) external;

    /// @notice From now on the judge of this number rules no more, and what it said and is not concluded is void until
    /// the case ends. Only the organization.
    function removeJudge(KindId kindId) external;

    /// @notice Returns whether the judge of this number was removed.
    function isRemoved(KindId kindId) external view returns (bool);

    /// @notice Send on what reached this contract by mistake. Only the organization.
    /// @param token_ the contract that it is of
    /// @return amount how much there was; of the payment token what exceeds `held`
    function rescue(IERC20 token_, address to) external returns (uint256 amount);
}
