// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {TaskId} from "../types/TaskId.sol";
import {IOracleCommittee} from "./IOracleCommittee.sol";
import {IOrganization} from "./IOrganization.sol";
import {ITaskManager, Verdict, Vote} from "./ITaskManager.sol";

/// @notice One committee of those that judge a kind one after the other.
/// @param committee whose judges vote
/// @param window how long its verdict can be challenged, s; of the last one 0
/// @param decision how long it may take over a challenge, s; of the first one 0
/// @param stake what a challenge of its verdict costs whoever is wrong, in the token's smallest unit; of the last one 0
/// @param judgeStake what each judge must have deposited for its vote to count, and loses if a later instance overturns
/// the verdict, in the token's smallest unit; 0 for none, as of the last one, which nothing overturns
struct Instance {
    IOracleCommittee committee;
    uint32 window;
    uint32 decision;
    uint96 stake;
    uint96 judgeStake;
}

/// @param content hash of the whole vote and of where its report lies; see close
/// @param verdict what the instance said
/// @param amount what it pays
/// @param voters one bit for each seat of its committee that voted for it
/// @param challenger who staked against it; 0 if nobody did
struct Ruling {
    bytes32 content;
    Verdict verdict;
    uint96 amount;
    uint64 voters;
    address challenger;
}

/// @title Verdicts that can be challenged before they settle.
/// @notice The organization gives ORACLE_ROLE to this contract instead of to its committee. A verdict of the first
/// instance waits for a window. In it a party to the task (for the organization an operator) or one of the kind's judges may
/// challenge it with a stake;
/// then the next instance decides, and so on to the last. What stands at the end is posted to the task manager. A
/// challenger whom the end proves right has the stake back, and the stake of one whom it proves wrong. A judge of a verdict
/// that was overturned loses its own stake to the organization's treasury.
/// @dev Every case ends: each step has an end in block time, close can be called by anybody, and the last end comes
/// before the task's own deadline. If nobody calls close, the task expires as one without verdict, and all stakes go
/// back, and no judge loses anything.
/// The stake of a judge belongs to its seat, so it stays when the key changes. One stake stands for all cases of its judge,
/// and none is locked for one: whoever posts many tasks does not use up the judges.
interface IDisputes {
    event InstancesChanged(bytes32 indexed kind, Instance[] instances);
    /// @notice The verdict stands at `until`, unless somebody challenges it.
    event Ruled(TaskId indexed taskId, uint8 indexed instance, Vote vote, string reportUri, uint256 until);
    /// @notice The next instance decides until `until`, else the verdict stands.
    event Challenged(
        TaskId indexed taskId,
        uint8 indexed instance,
        address indexed challenger,
        uint256 stake,
        uint256 until,
        string reason
    );
    event CaseClosed(TaskId indexed taskId, uint8 attempt, Verdict verdict, uint256 amount);
    /// @notice The attempt ended in another way. Nobody was wrong.
    event CaseVoided(TaskId indexed taskId, uint8 attempt);
    /// @param account who got it: the challenger or its opponent, or the payout address of either; the organization for
    /// what its judges lost
    event StakePaid(TaskId indexed taskId, address indexed account, uint256 amount);
    /// @notice The token refused it; see withdrawPayments.
    event StakeDeferred(address indexed account, uint256 amount);
    /// @param committee any contract: a judge's stake counts only where an instance names its committee
    /// @param payer whose tokens they were
    event StakeDeposited(
        IOracleCommittee indexed committee, uint8 indexed seat, address indexed payer, uint256 amount
    );
    /// @notice That much counts no more for votes. It can be paid out after `until`.
    event WithdrawalAnnounced(
        IOracleCommittee indexed committee, uint8 indexed seat, uint256 amount, uint256 until
    );
    /// @param account who got it: the seat's owner, or its payout address
    event StakeWithdrawn(
        IOracleCommittee indexed committee, uint8 indexed seat, address indexed account, uint256 amount
    );
    /// @notice The judge voted for a verdict that was overturned.
    event StakeLost(
        TaskId indexed taskId, IOracleCommittee indexed committee, uint8 indexed seat, uint256 amount
    );

    error NotAdministrator(address account);
    error InvalidInstances(bytes32 kind, uint256 index);
    /// @notice The same key would decide about its own verdict.
    error JudgesTwice(bytes32 kind, address key);
    /// @notice A creator could choose a window in which no case ends: set the kind's shortest one first.
    error VerdictWindowTooShort(bytes32 kind, uint32 window, uint256 longestCase);
    error KindWithoutInstances(bytes32 kind);
    /// @notice Too little of the verdict window is left for challenges.
    error TooLate(TaskId taskId, uint256 needed, uint256 deadline);
    /// @notice A verdict stands already, and nobody has challenged it.
    error NotChallenged(TaskId taskId);
    /// @notice The verdict is before the next instance.
    error ChallengedBefore(TaskId taskId, address challenger);
    /// @notice Whoever decides a challenge has to.
    error MustDecide(TaskId taskId);
    error NoCase(TaskId taskId);
    error WindowOver(TaskId taskId, uint256 until, uint256 time);
    error WindowNotOver(TaskId taskId, uint256 until, uint256 time);
    error NeitherPartyNorJudge(TaskId taskId, address account);
    /// @notice Not what the instance said.
    error OtherVerdict(TaskId taskId, bytes32 content, bytes32 expected);
    error NothingOwed(address account);
    error NoJudge(IOracleCommittee committee, uint8 seat);
    error NotOwner(address account, address owner);
    /// @notice What is being withdrawn does not count.
    error StakeTooLow(IOracleCommittee committee, uint8 seat, uint256 stake, uint256 needed);
    error NoWithdrawal(IOracleCommittee committee, uint8 seat);
    error WithdrawalTooEarly(IOracleCommittee committee, uint8 seat, uint256 until, uint256 time);

    // -- administrator ------------------------------------------------------------------------------------

    /// @notice Say who judges `kind` from now on. Cases that run keep what they began with.
    /// @param kind what is to be done, ASCII
    /// @param instances one to three, in their order, of different judges; each later one needs more votes and a
    /// greater stake than the one before. Each committee needs its quorum for the kind first, and the kind a shortest
    /// verdict window above longestCase.
    function setInstances(bytes32 kind, Instance[] calldata instances) external;

    // -- anybody ------------------------------------------------------------------------------------------

    /// @notice Bring the verdict of the instance whose turn it is. An undecided one goes to the auditors at once. One vote
    /// of a judge whose stake is too low fails all of it (StakeTooLow), so leave that vote out.
    /// @param vote what its judges signed
    /// @param reportUri where the report lies
    /// @param signatures of different judges in any order, 64 bytes each (EIP-2098)
    function postVotes(Vote calldata vote, string calldata reportUri, bytes calldata signatures) external;

    /// @notice Post the verdict that stands, or end the case of an attempt that is over.
    /// @param vote as the event Ruled has it
    /// @param reportUri as the event Ruled has it
    function close(Vote calldata vote, string calldata reportUri) external;

    /// @notice Pay `account`, or its payout address, what the token refused before.
    /// @param account whose money waits
    function withdrawPayments(address account) external;

    /// @notice Add to the stake of a judge, by the caller's allowance for this contract. It is the judge's from then on.
    /// @param committee in which the judge sits
    /// @param seat of the judge
    /// @param amount in the token's smallest unit
    function depositStake(IOracleCommittee committee, uint8 seat, uint256 amount) external;

    /// @notice Pay the seat's owner, or its payout address, what was announced and is left of it.
    /// @param committee in which the judge sits
    /// @param seat of the judge
    function withdrawStake(IOracleCommittee committee, uint8 seat) external;

    // -- who owns a judge ---------------------------------------------------------------------------------

    /// @notice Begin to take a stake back. It counts no more for votes, but can still be lost for votes that were counted
    /// before. Announcing again adds to what was announced, and begins the time anew. Only the owner of the seat: whoever
    /// takes the judge's key gets nothing by it.
    /// @param committee in which the judge sits
    /// @param seat of the judge
    /// @param amount in the token's smallest unit
    function announceWithdrawal(IOracleCommittee committee, uint8 seat, uint256 amount) external;

    // -- a party or a judge -------------------------------------------------------------------------------

    /// @notice Have the next instance decide. The caller's stake is taken by its allowance for this contract.
    /// @param taskId whose verdict
    /// @param reason why it is wrong, as people read it
    function challenge(TaskId taskId, string calldata reason) external;

    // -- views --------------------------------------------------------------------------------------------

    function organization() external view returns (IOrganization);
    function tasks() external view returns (ITaskManager);
    /// @notice Who judges `kind`, in the order of the instances.
    /// @param kind what is to be done, ASCII
    function instancesOf(bytes32 kind) external view returns (Instance[] memory);

    /// @notice How long a case of this kind lasts at most after the first verdict, s. It has to fit into the verdict
    /// window together with the judges' work.
    /// @param kind what is to be done, ASCII
    function longestCase(bytes32 kind) external view returns (uint256);

    /// @notice The verdicts so far on the running case; none where there is none.
    /// @param taskId whose verdicts
    /// @return rulings in the order of the instances
    /// @return challenged whether the last of them is before the next instance
    /// @return until the end of the running window
    function caseOf(TaskId taskId)
        external
        view
        returns (Ruling[] memory rulings, bool challenged, uint256 until);

    /// @notice What waits for `account` in withdrawPayments.
    /// @param account whose money waits
    function pendingPayments(address account) external view returns (uint256);

    /// @notice What is deposited for a judge.
    /// @param committee in which the judge sits
    /// @param seat of the judge
    /// @return stake what counts for its votes
    /// @return leaving what is being withdrawn, which can be lost, too
    /// @return until when that can be paid out, block time in s
    function stakeOf(IOracleCommittee committee, uint8 seat)
        external
        view
        returns (uint256 stake, uint256 leaving, uint256 until);
}
