// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {KindId} from "../types/KindId.sol";
import {ServiceId} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";
import {IDeviceRegistry, Revocation} from "./IDeviceRegistry.sol";
import {IJudge} from "./IJudge.sol";
import {IMatchingPolicy} from "./IMatchingPolicy.sol";
import {Terms} from "./IProviders.sol";
import {IServiceManager, ServiceState} from "./IServiceManager.sol";
import {ITaskManager, TaskRequest} from "./ITaskManager.sol";

/// @dev Bounds of execution and verdict windows, s. In a shorter one nobody can answer.
uint32 constant MIN_WINDOW = 1 minutes;
uint32 constant MAX_WINDOW = 30 days;
/// @dev Grace periods are multiples of it, s.
uint32 constant GRACE_STEP = 10 seconds;
/// @dev The longest grace period, s: what a task has in eight bits.
uint32 constant MAX_GRACE = 255 * GRACE_STEP;
/// @dev Verdict and audit window together: a longer case would keep the reward from both sides.
uint32 constant MAX_CASE = 30 days;
/// @dev The gas in which a judge says its terms.
uint256 constant JUDGE_GAS = 200_000;
/// @dev Numbers that kinds have in the life of an organization, one with each judge: a task or service has it in 8 bits.
uint8 constant MAX_KINDS = 255;
/// @dev Current rules of one kind. The creator of a task pays for looking through them.
uint256 constant MAX_RULES = 8;
/// @dev Long enough to find out what is wrong, too short to starve anybody. Two pauses are as far apart.
uint32 constant MAX_PAUSE = 3 days;
/// @dev With fewer members nobody votes: two of them could not outvote one.
uint256 constant MIN_VOTERS = 3;

/// @notice An administrator that does what members decide by vote supports this interface (ERC-165). While it administers
/// an organization, that has at least MIN_VOTERS members.
interface IDecidedByMembers {
    /// @notice Returns whether members decide by vote.
    function decidedByMembers() external view returns (bool);
}

/// @notice The amount that a role may take out of the treasury. Posting a task costs its reward and offering a service its bond,
/// whatever comes back of them later.
/// @param amount in one period, in the token's smallest unit
/// @param period s; 0: no limit
/// @param since when the running period began. The next one begins with the first payment after its end, so that in
/// any time of that length at most twice the amount leaves.
/// @param spent in the running period
struct Budget {
    uint96 amount;
    uint24 period;
    uint40 since;
    uint96 spent;
}

/// @notice The times of work of one kind.
/// @param minWindow the shortest execution window that a task may have, from assignment to proof, s
/// @param maxWindow the longest, s
/// @param grace how long an executor may give a task back, s: at most half of `minWindow`
/// @param minVerdictWindow the shortest verdict window that a task may have, in which an honest judge answers, s
/// @param maxVerdictWindow the longest, for which a proof that nobody judges may keep a service busy, s
/// @param auditWindow how much longer than the verdict window a ruling can be replaced, s; 0: what stands at the end of the
/// verdict window is final
struct Windows {
    uint32 minWindow;
    uint32 maxWindow;
    uint16 grace;
    uint32 minVerdictWindow;
    uint32 maxVerdictWindow;
    uint32 auditWindow;
}

/// @notice The rules for work of one kind: its Windows, and its judge. One word, which every new task reads.
/// @param maxWindow 0 before setWindows
/// @param judgesWindow what its judge wants as the shortest verdict window, s
/// @param maxCase what its judge wants as the longest case, verdict and audit window together, s
/// @param number of the kind with the judge that it has now, from 1; 0 before it has one
struct Kind {
    bool allowed;
    uint32 minWindow;
    uint32 auditWindow;
    uint32 minVerdictWindow;
    uint32 maxVerdictWindow;
    uint32 judgesWindow;
    uint32 maxCase;
    KindId number;
    uint32 maxWindow;
    uint16 grace;
}

/// @title The organization: who may do what, which work it accepts, how tasks meet services, and its treasury.
/// @notice It is itself a participant: its operator posts tasks and offers services in its name, rewards come
/// from and income goes to its own token balance. types/Roles.sol lists the roles. A `kind` is the name of a
/// kind of work, ASCII, and a `KindId` the number that it has with one judge.
interface IOrganization {
    /// @param number of the kind with this judge
    /// @param rules 0 where people judge and no rules were named
    /// @param judgesWindow the shortest verdict window that the judge asks for, s
    /// @param maxCase the longest case that it takes, s
    event KindAllowed(
        bytes32 indexed kind,
        KindId indexed number,
        IJudge judge,
        bytes32 rules,
        uint32 judgesWindow,
        uint32 maxCase
    );
    /// @notice The judge of this number rules no more.
    event JudgeRemoved(KindId indexed number, IJudge judge);
    /// @notice These auditors rule where a judge was removed.
    event AuditorsChanged(IJudge indexed auditors);
    event RulesRetired(bytes32 indexed kind, bytes32 rules);
    event KindDisallowed(bytes32 indexed kind);
    /// @param referencePrice the most that an attempt counts in its provider's record, in the token's smallest unit
    event WindowsChanged(bytes32 indexed kind, Windows windows, uint256 referencePrice);
    event TermsChanged(uint256 bond, uint256 penalty, uint8 maxFailures);
    event MembersOnlyChanged(bool membersOnly);
    /// @notice Its services are suspended, too.
    event ProviderSuspended(address indexed provider);
    event ProviderReinstated(address indexed provider);
    event PolicyChanged(IMatchingPolicy indexed policy);
    /// @param role operators or treasurers
    /// @param period s; 0: no limit
    event BudgetChanged(bytes32 indexed role, uint256 amount, uint256 period);
    event TasksPaused(address indexed guardian, uint256 until);
    event TasksResumed(address indexed account);
    event Deposited(address indexed from, uint256 amount);
    event Withdrawn(address indexed to, uint256 amount);
    event TokensRescued(IERC20 indexed token, address indexed to, uint256 amount);

    error UnknownKind(bytes32 kind);
    /// @notice An organization has rules for up to 255 kinds in its life.
    error TooManyKinds(bytes32 kind, uint256 max);
    /// @notice It does not judge this kind: it has no terms for it, or wants a verdict window that is shorter than
    /// MIN_WINDOW or a case that is longer than MAX_CASE.
    error InvalidJudge(bytes32 kind, address judge);
    error UnknownNumber(KindId number);
    /// @notice A kind that has rules keeps at least one while it is allowed.
    error KindWithoutRules(bytes32 kind);
    /// @notice Tasks are posted under rules that are current, and only current ones are retired.
    error RulesNotCurrent(bytes32 kind, bytes32 rules);
    /// @notice Retire rules that no oracle has any more. See retireRules.
    error TooManyRules(bytes32 kind, uint256 max);
    /// @notice The organization is for members only.
    error NotMember(address account);
    /// @notice It offers no service until the administrator reinstates it.
    error ProviderIsSuspended(address provider);
    error ProviderNotSuspended(address provider);
    /// @notice The organization suspends its own services one by one.
    error OrganizationIsProvider();
    /// @notice In a shorter one the work cannot be done; a longer one keeps the reward from everybody else.
    error InvalidWindow(bytes32 kind, uint32 window, uint32 min, uint32 max);
    /// @notice The bounds of a kind's execution or verdict windows have bounds themselves, and the lower one comes first.
    error InvalidWindows(uint32 min, uint32 max, uint32 lowest, uint32 highest);
    /// @notice A grace period is a multiple of `step` and at most `longest`, half of the shortest execution window.
    error InvalidGrace(uint32 grace, uint32 step, uint256 longest);
    /// @notice See setWindows.
    error KindWithoutWindows(bytes32 kind);
    /// @notice In a shorter one no honest judge can answer; a longer one freezes service and bond.
    error InvalidVerdictWindow(bytes32 kind, uint32 window, uint32 min, uint32 max);
    error InvalidTerms(uint256 bond, uint256 penalty, uint8 maxFailures);
    error InvalidPolicy(address policy);
    /// @notice Only operators and treasurers take anything out of the treasury.
    error RoleWithoutBudget(bytes32 role);
    /// @notice Members vote only if there are `min`, and while they vote, so many remain.
    error TooFewMembers(uint256 members, uint256 min);
    /// @notice Only contracts pay shares; keys have budgets.
    error NotAContract(address account);
    /// @notice The role may take `left` until the period ends at `until`.
    error OverBudget(bytes32 role, uint256 amount, uint256 left, uint256 until);
    /// @notice Under this address, too, it is the token of the organization, of which escrow and treasury are not rescued.
    error NotByMistake(IERC20 token);
    /// @notice A guardian has paused new tasks.
    error TasksArePaused(uint256 until);
    error InvalidPause(uint32 duration, uint32 max);
    /// @notice A guardian may pause again at `earliest`.
    error PausedRecently(uint256 earliest);

    // -- administrator ------------------------------------------------------------------------------------

    /// @notice Accept tasks and services of `kind` from now on, and let `judge` rule on their proofs. Another judge than
    /// before makes another number of the kind: its rules are retired, and its services get only tasks that were posted
    /// before, until their providers agree (IServiceManager.agree). The judge is asked for its terms once, here.
    /// @param judge who rules
    /// @param rules SHA-256 of the rules by which it is judged. They become the newest, beside those that are
    /// current. 0, where people judge, names none.
    function allowKind(bytes32 kind, IJudge judge, bytes32 rules) external;

    /// @notice Post no tasks under `rules` from now on. Those that were posted under them keep them.
    /// @param rules one of currentRules; never the last while the kind is allowed
    function retireRules(bytes32 kind, bytes32 rules) external;

    /// @notice Accept no tasks and services of `kind` from now on, and retire all its rules. Live tasks go on, with
    /// the judges and the rules that they have.
    function disallowKind(bytes32 kind) external;

    /// @notice Name the contract that rules on proofs whose judge was removed.
    function setAuditors(IJudge auditors_) external;

    /// @notice Set the windows and the reference price of a kind, before it is allowed for the first time. A task that was posted
    /// before keeps what it had. An attempt that ends from now on counts in its provider's record by its value, but at most as
    /// `referencePrice`, whichever judge it has: nobody buys a name with one dear task.
    /// @param windows what tasks of this kind are refused outside of
    /// @param referencePrice what such work usually costs: a price as services have it, not 0 (IServiceManager.InvalidPrice, here
    /// or, while the kind has no number, when it is allowed)
    function setWindows(bytes32 kind, Windows calldata windows, uint96 referencePrice) external;

    /// @notice Send on what reached the task manager or this contract by mistake, and nothing else: of the token of
    /// the organization what neither escrow, bonds nor anybody's `pendingPayments` accounts for, of any other token all.
    /// @param token_ the contract that it is of
    function rescueTokens(IERC20 token_, address to) external;

    /// @notice Set the terms of services that are registered from now on. Those that are there keep their terms.
    function setTerms(Terms calldata terms_) external;

    /// @notice Take tasks and services from members only, or from everyone. Live ones go on.
    function setMembersOnly(bool membersOnly_) external;

    /// @notice Vouch for a provider, so that it is proven without work, or do so no longer. Members are vouched for.
    function vouchFor(address provider, bool vouched) external;

    /// @notice No new task for the service; a running one continues.
    function suspendService(ServiceId serviceId) external;

    /// @notice Suspend all services of a provider, and let it register none. A running task continues, and a service
    /// that the provider retires gives its bond back as always.
    /// @param provider any account but the organization, also one that offers nothing yet
    function suspendProvider(address provider) external;

    /// @notice Let a suspended provider register services again. Those that it has stay suspended: see
    /// reinstateService.
    function reinstateProvider(address provider) external;

    /// @notice Forgive a suspended service its failures. Its provider finds it paused. A provider that is suspended is
    /// reinstated first.
    function reinstateService(ServiceId serviceId) external;

    /// @notice Let `device` sign as the `role` called `name`, for `owner`. The key itself has to agree to this owner.
    /// Again, with the same role and name, it corrects the owner.
    /// @param device address of its key
    /// @param role what it is, ASCII: robot, bin, meter, mocap
    /// @param owner who answers for it
    /// @param name on its site, ASCII
    /// @param r of the key's signature (EIP-712, EIP-2098) of Possession(device, owner, deviceNonce), for `devices`
    /// @param vs the rest of that signature
    function registerDevice(address device, bytes32 role, address owner, bytes32 name, bytes32 r, bytes32 vs)
        external;

    /// @notice Invalidate everything the device signs from now on. `reason` decides about earlier signatures.
    /// @param device address of its key
    /// @param reason Compromised: what it signed before counts no more either
    function revokeDevice(address device, Revocation reason) external;

    /// @notice Replace the matching policy. Queues and live tasks stay as they are. Services that become free while tasks wait
    /// ask the new one from the next task on, if it replaces FirstComeFirstServed.
    /// @param policy_ what matches from now on; a contract
    function setPolicy(IMatchingPolicy policy_) external;

    /// @notice Limit what all holders of `role` together take out of the treasury. The first period begins now.
    /// @param role OPERATOR_ROLE or TREASURER_ROLE
    /// @param amount in one period, in the token's smallest unit
    /// @param period s; 0: no limit
    function setBudget(bytes32 role, uint96 amount, uint24 period) external;

    // -- guardian -----------------------------------------------------------------------------------------

    /// @notice A judge rules no more, from this call on: what it said and is not concluded is void until the case ends, and
    /// the auditors may replace it. Nobody posts tasks of the kind until allowKind names its judge anew. The administrator,
    /// or a guardian.
    /// @param number of the kinds that it judges
    function removeJudge(KindId number) external;

    /// @notice Take no new tasks for `duration` seconds, MAX_PAUSE at most. Everything else continues: running windows,
    /// proofs, verdicts, expiry, refunds and withdrawals, and tasks that wait still find services. After a pause no
    /// guardian can pause for MAX_PAUSE, so that new tasks are taken at least half of the time.
    function pauseTasks(uint32 duration) external;

    /// @notice End the pause now: a guardian, or the administrator.
    function resumeTasks() external;

    // -- operator -----------------------------------------------------------------------------------------

    // What ITaskManager and IServiceManager say of the functions of the same names, in the organization's name.
    // `registerTask` and `registerService` count on the operators' budget.

    function registerTask(TaskRequest calldata request) external returns (TaskId taskId);
    function cancelTask(TaskId taskId) external;
    function acceptTask(TaskId taskId, uint8 attempt) external;
    function abandonTask(TaskId taskId, uint8 attempt) external;
    function submitProof(TaskId taskId, uint8 attempt, bytes32 proofHash, string calldata uri) external;
    function registerService(
        bytes32 kind,
        uint256 price,
        uint256 maxBond,
        bool autoAccept,
        string calldata description
    ) external returns (ServiceId serviceId);
    function updateService(ServiceId serviceId, uint256 price, ServiceState state) external;
    function agree(ServiceId serviceId) external;

    // -- treasurer ----------------------------------------------------------------------------------------

    /// @notice Move `amount` of the caller's tokens into the treasury; the caller approved it before.
    /// @param amount in the token's smallest unit
    function deposit(uint256 amount) external;

    /// @notice Pay `amount` out of the treasury. What is in escrow is out of reach.
    /// @param amount in the token's smallest unit
    function withdraw(address to, uint256 amount) external;

    // -- allocator ----------------------------------------------------------------------------------------

    /// @notice Pay a share of an amount that the administrator had members split (BudgetVotes): it counts on no budget.
    /// Only a contract can have ALLOCATOR_ROLE.
    /// @param amount in the token's smallest unit
    function payShare(address to, uint256 amount) external;

    // -- views --------------------------------------------------------------------------------------------

    function token() external view returns (IERC20);
    function services() external view returns (IServiceManager);
    function tasks() external view returns (ITaskManager);

    /// @notice Returns the keys that may sign evidence, in a contract of its own.
    function devices() external view returns (IDeviceRegistry);
    function policy() external view returns (IMatchingPolicy);

    function terms() external view returns (Terms memory);
    function membersOnly() external view returns (bool);

    /// @notice Whether the administrator has suspended a provider.
    function isSuspended(address provider) external view returns (bool);

    /// @notice No new tasks are taken before this time; in the past where there is no pause, 0 if there was none.
    function pausedUntil() external view returns (uint40);

    /// @notice The budget of `role`: OPERATOR_ROLE or TREASURER_ROLE.
    function budgetOf(bytes32 role) external view returns (Budget memory);

    /// @notice The rules for work of `kind`.
    function kindOf(bytes32 kind) external view returns (Kind memory);

    /// @notice Returns the most that an attempt at a task of `kind` counts in its provider's record; 0 before setWindows.
    function referencePriceOf(bytes32 kind) external view returns (uint96);

    /// @notice SHA-256 of each of the rules under which tasks of `kind` may be posted now, the newest last.
    function currentRules(bytes32 kind) external view returns (bytes32[] memory);

    function memberCount() external view returns (uint32);

    /// @notice Whether `account` has MEMBER_ROLE. By revokeRole it loses it: where only members take part, its services are then
    /// suspended, and running tasks go on.
    function isMember(address account) external view returns (bool);

    /// @notice Returns who rules on tasks of this number; 0 if there is no such number.
    /// @param number see numberOf
    function judgeNumbered(KindId number) external view returns (IJudge);

    /// @notice Returns who rules where a judge was removed.
    function auditors() external view returns (IJudge);

    /// @notice Returns the number of a kind with the judge that it has now, from 1; 0 if it never had one.
    function numberOf(bytes32 kind) external view returns (KindId);

    /// @notice Returns the kind with this number; 0 if there is none.
    /// @param number see numberOf
    function kindNumbered(KindId number) external view returns (bytes32);

    /// @notice Reverts with TasksArePaused, UnknownKind, NotMember, InvalidWindow, InvalidVerdictWindow or
    /// RulesNotCurrent unless `creator` may post such a task.
    /// @param creator who posts it
    /// @param executionWindow seconds from assignment to proof
    /// @param verdictWindow seconds from proof to verdict
    /// @param wantedRules the rules that the creator names; 0 for the newest
    /// @param restricted see admission: the caller has it in a word of its own, and saves what looking here costs
    /// @return rules by which it is judged; 0 where people judge and no rules were named
    /// @return kindId the number of the kind
    /// @return auditWindow how much longer than the verdict window a ruling can be replaced, s
    /// @return grace how long an executor may give it back, s
    function admitTask(
        bytes32 kind,
        address creator,
        uint32 executionWindow,
        uint32 verdictWindow,
        bytes32 wantedRules,
        bool restricted
    ) external view returns (bytes32 rules, KindId kindId, uint32 auditWindow, uint32 grace);

    /// @notice What a new task has to look up here, besides its kind.
    /// @return asks whether the policy has to be asked, because it is not FirstComeFirstServed
    /// @return restricted whether only members post tasks, or nobody before the end of a pause
    function admission() external view returns (bool asks, bool restricted);

    /// @notice Reverts with UnknownKind or NotMember unless `provider` may offer such a service.
    /// @param provider who offers it
    /// @return agreed what it agrees to
    /// @return kindId the number of the kind
    function admitService(bytes32 kind, address provider)
        external
        view
        returns (Terms memory agreed, KindId kindId);
}
