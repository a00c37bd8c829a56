// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {KindId} from "../types/KindId.sol";
import {Parties} from "../types/Parties.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {Submission} from "../types/Submission.sol";
import {TaskId} from "../types/TaskId.sol";
import {IServiceListener} from "./IServiceListener.sol";
import {Hire} from "./IServiceManager.sol";

enum TaskState {
    None,
    Open,
    Assigned,
    Submitted,
    Undecided,
    Settled,
    Cancelled,
    Failed
}

/// @notice What a judge says of a proof. Undecided: neither side failed, and the organization's auditors decide.
/// Impossible: nobody could do this task. It ends, and the executor is paid a part of the price for its trouble.
enum Verdict {
    None,
    Rejected,
    Accepted,
    Undecided,
    Impossible
}

/// @notice Why an attempt failed. NotAccepted: the executor did not accept it in the grace period. Abandoned: the
/// executor gave it back in the grace period. AbandonedLate: the executor had accepted it, and gave it back after the
/// grace period.
enum Cause {
    Rejected,
    ExecutionExpired,
    VerdictExpired,
    AuditExpired,
    NotAccepted,
    Abandoned,
    AbandonedLate
}

/// @notice Who wins when the judges, or the auditors, let their window pass. None: neither, and the attempt is void.
enum Silence {
    None,
    Executor,
    Creator
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

/// @param price what the executor of the running (or last) attempt is paid at most
/// @param serviceId the service of the running (or last) attempt; while open the one that the task names, or 0
/// @param provider the provider that the task names; 0 if it names none
/// @param deadline end of the running window, block time in seconds; 0 when none runs
/// @param attempt 1 for the first assignment
/// @param accepted the executor of the running (or last) attempt agreed to it; see acceptTask
/// @param hired whether the creator named the service, or the provider
/// @param proofHash SHA-256 of the proof that waits for its verdict; 0 unless Submitted or Undecided, earlier ones
/// are in events
struct Task {
    address creator;
    uint96 reward;
    bytes32 kind;
    uint96 price;
    ServiceId serviceId;
    address provider;
    uint40 deadline;
    uint32 executionWindow;
    uint32 verdictWindow;
    uint8 attempt;
    uint8 maxAttempts;
    TaskState state;
    bool accepted;
    Hire hired;
    bytes32 proofHash;
}

/// @notice What a judge signs (EIP-712): the whole verdict, but not where its report lies.
/// @param taskId which task,
/// @param attempt which attempt at it
/// @param proofHash SHA-256 of the proof that was judged
/// @param reportHash SHA-256 of the report; judges whose reports differ in one number do not agree
/// @param rulesHash SHA-256 of the rules that were applied
/// @param verdict what the judge says
/// @param amount what an accepted proof is paid, in the token's smallest unit
/// @param reason the verdict's reason, as people read it
struct Vote {
    TaskId taskId;
    uint8 attempt;
    bytes32 proofHash;
    bytes32 reportHash;
    bytes32 rulesHash;
    Verdict verdict;
    uint256 amount;
    string reason;
}

/// @title Tasks and their escrow.
/// @notice
///     Open ──match──> Assigned ──proof──> Submitted ──accepted──> Settled
///      │ ^               │                    │  │                 ^
///      │ └───────────────┴── expired, rejected ┘  └─undecided─> Undecided ──rejected──> Open or Failed
///      └──> Cancelled      (Failed at the last)                (silent auditors: Settled or Failed)
/// The whole reward is held from registration to one of the three terminal states, in which the executor has what the
/// verdict gave it and the creator the rest. The contract holds the bonds of services as well; whatever else it is
/// sent can be rescued. An undecided attempt is over for its service: it costs it neither bond nor standing nor its
/// next task.
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
        TaskId indexed taskId,
        uint8 attempt,
        address indexed executor,
        bytes32 indexed proofHash,
        string uri,
        uint256 deadline
    );
    event VerdictPosted(
        TaskId indexed taskId,
        uint8 attempt,
        bytes32 indexed proofHash,
        Verdict verdict,
        uint256 amount,
        bytes32 reportHash,
        string reportUri,
        string reason
    );
    /// @notice Follows an undecided verdict: auditors decide until `deadline`, else `silence` does.
    event AuditRequested(TaskId indexed taskId, uint8 attempt, uint256 deadline, Silence silence);
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
    /// @notice The token refused the transfer, or wanted more gas than PAYMENT_GAS; the amount is kept until
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
    /// @notice The organization lets others judge work of this kind. See IOrganization.allowKind.
    error NotJudge(address caller, bytes32 kind);
    /// @notice Whoever could not decide does not decide afterwards.
    error JudgedBefore(TaskId taskId, address caller);
    /// @notice Only an oracle may leave a proof undecided, only once, and only of a task whose kind had an audit when it
    /// was posted: auditors accept or reject.
    error AuditorMustDecide(TaskId taskId, address caller);
    error NoVerdict(TaskId taskId);
    /// @notice Accepted work is paid more than nothing and at most its price, other verdicts pay nothing.
    error InvalidAmount(TaskId taskId, uint256 amount, uint256 max);
    /// @notice Neither the creator nor the executor judges, nor whoever owns one of them or has the same owner.
    error JudgeIsParty(TaskId taskId, address caller);
    error NotServiceManager(address caller);
    error NotOrganization(address caller);
    error InvalidWindow(uint32 window, uint32 min, uint32 max);
    error InvalidAttempts(uint8 attempts, uint8 max);
    /// @notice A task names a service or a provider, not both.
    error TwoNamed(uint32 serviceId, address provider);
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

    /// @notice registerTask with the approval (EIP-2612) of the reward in the same transaction.
    /// @dev If somebody used the permit before, the allowance is there, and the call succeeds.
    /// @param request the task
    /// @param deadline until when the permit is valid, block time in seconds
    /// @param v of the signature of the permit
    /// @param r of the signature of the permit
    /// @param s of the signature of the permit
    /// @return taskId the number of the task, counted from 1
    function registerTaskWithPermit(
        TaskRequest calldata request,
        uint256 deadline,
        uint8 v,
        bytes32 r,
        bytes32 s
    ) external returns (TaskId taskId);

    /// @notice The creator cancels an open task, and gets the whole reward back.
    /// @param taskId an open task of the caller
    function cancelTask(TaskId taskId) external;

    /// @notice The executor agrees to do the assigned task. If it then delivers no proof in time, or a judge rejects
    /// its proof, it pays the penalty of its terms. A proof accepts, too. Services with `autoAccept` need no call.
    /// @param taskId an assigned task
    /// @param attempt the running attempt
    function acceptTask(TaskId taskId, uint8 attempt) external;

    /// @notice The executor gives the assigned task back, and the attempt ends. This costs it nothing in the first
    /// quarter of the execution window, nor later if it has not accepted the task. Otherwise it counts as an attempt
    /// without a proof. In the grace period it counts toward MAX_MISSED only if another provider then does the task,
    /// see IServiceManager.countAbandoned; later it does. A task that named who gives it back in the grace period has
    /// failed: it would be offered to nobody else.
    /// @param taskId an assigned task
    /// @param attempt the running attempt
    function abandonTask(TaskId taskId, uint8 attempt) external;

    /// @notice The executor submits the hash of its proof, once in each attempt, in the execution window.
    /// @param taskId the task that the caller does
    /// @param attempt the running attempt
    /// @param proofHash SHA-256 of the recording
    /// @param uri where it can be fetched; only in the event
    function submitProof(TaskId taskId, uint8 attempt, bytes32 proofHash, string calldata uri) external;

    /// @notice A judge decides on the submitted proof in the verdict window. The organization names the judges of each
    /// kind: oracles or auditors. After an undecided verdict an auditor decides, in the audit window.
    /// @param taskId the task
    /// @param attempt the attempt that was judged
    /// @param proofHash the proof that was judged
    /// @param verdict what the judge decides
    /// @param amount what the executor is paid if the proof is accepted, at most the price; otherwise 0
    /// @param reportHash SHA-256 of the report
    /// @param reportUri where the report can be fetched; only in the event
    /// @param reason why, in words; only in the event
    /// @return judged what was judged, as it was before the verdict
    /// @return parties those to the task, or NO_PARTIES; see IServiceManager.rightOf
    function postVerdict(
        TaskId taskId,
        uint8 attempt,
        bytes32 proofHash,
        Verdict verdict,
        uint256 amount,
        bytes32 reportHash,
        string calldata reportUri,
        string calldata reason
    ) external returns (Submission judged, Parties parties);

    /// @notice Anyone ends an attempt whose window has passed, or that its executor did not accept in the grace
    /// period. The task queues again, or fails and its creator is refunded. If nobody judged a proof in time and the
    /// kind lets the executor win, the task settles at the full price. The same applies if the auditors did not
    /// decide.
    /// @param taskId a task that is assigned, submitted or undecided
    function expireTask(TaskId taskId) external;

    /// @notice Anyone asks the policy again for an open task. This is useful only after PolicyFailed.
    /// @param taskId an open task
    function matchTask(TaskId taskId) external;

    /// @notice What a committee has to know of a task before it judges. Reverts with WrongState unless a proof waits for
    /// its verdict.
    /// @param taskId the task
    /// @return submitted what is to be judged
    /// @return parties those to the task
    function toJudge(TaskId taskId) external view returns (Submission submitted, Parties parties);

    /// @notice Returns a task as it is now. Reverts with UnknownTask.
    /// @param taskId its number
    function task(TaskId taskId) external view returns (Task memory);

    /// @notice Anyone has the amount paid that the token refused to transfer before. The account's payout address gets
    /// it, so that an account that the token refuses for ever can name another one (IServiceManager.setPayout).
    /// @param account who is owed something
    function withdrawPayments(address account) external;

    /// @notice Returns the amount that the token refused to transfer.
    /// @param account who is owed it
    function pendingPayments(address account) external view returns (uint256);

    /// @notice The part of the price that an executor is paid for a task that is impossible: one in so many.
    // solhint-disable-next-line func-name-mixedcase
    function IMPOSSIBLE_SHARE() external view returns (uint256);

    /// @notice Returns what this contract owes, in the token's smallest unit: rewards of live tasks, bonds and `pendingPayments`.
    function held() external view returns (uint256);

    /// @notice A kind is judged by others from now on, its tasks that run included. Only the organization.
    function onReviewChanged() external;

    /// @notice Send on what reached this contract by mistake. Only the organization.
    /// @param token_ the contract that it is of
    /// @param to who gets it
    /// @return amount how much there was; of the payment token what exceeds `held`
    function rescue(IERC20 token_, address to) external returns (uint256 amount);
}
