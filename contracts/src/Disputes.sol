// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {IDisputes, Instance, Ruling} from "./interfaces/IDisputes.sol";
import {IOracleCommittee, Quorum} from "./interfaces/IOracleCommittee.sol";
import {IOrganization} from "./interfaces/IOrganization.sol";
import {IServiceManager} from "./interfaces/IServiceManager.sol";
import {ITaskManager, Task, TaskState, Verdict, Vote} from "./interfaces/ITaskManager.sol";
import {Payments} from "./libraries/Payments.sol";
import {Texts} from "./libraries/Texts.sol";
import {TaskId} from "./types/TaskId.sol";

contract Disputes is IDisputes {
    using SafeCast for uint256;
    using SafeERC20 for IERC20;

    /// @param attempt of the task
    /// @param version which of the kind's lists of instances the case began with, counted from 1
    /// @param count how many instances have ruled
    /// @param challenged the last ruling is before the next instance
    /// @param until end of the running window, block time in s
    struct Case {
        uint8 attempt;
        uint32 version;
        uint8 count;
        bool challenged;
        uint40 until;
        Ruling[3] rulings;
    }

    /// @dev What is deposited for a judge; see stakeOf.
    struct Deposit {
        uint96 stake;
        uint96 leaving;
        uint40 until;
    }

    /// @notice A committee, the one above it, and one appeal: as many as a Case has rulings.
    uint256 public constant MAX_INSTANCES = 3;
    /// @notice In a shorter window nobody can answer.
    uint32 public constant MIN_WINDOW = 1 minutes;
    /// @notice A longer one freezes service and bond.
    uint32 public constant MAX_WINDOW = 7 days;
    /// @notice How long a judge's stake can still be lost after it was announced to leave: the longest time from a vote to
    /// the end of its case. MAX_INSTANCES of MAX_WINDOW each, and as long for their decisions, would be longer. But a case
    /// that overturns anything ends before the deadline of its task, whose verdict window is at most
    /// Organization.MAX_VERDICT_WINDOW.
    uint32 public constant UNBONDING = 30 days;

    bytes32 private constant ADMINISTRATOR = 0;
    bytes32 private constant OPERATOR = keccak256("OPERATOR_ROLE");

    /// @inheritdoc IDisputes
    IOrganization public immutable organization;
    /// @inheritdoc IDisputes
    ITaskManager public immutable tasks;
    IServiceManager private immutable _services;
    IERC20 private immutable _token;

    mapping(bytes32 kind => Instance[][]) private _instances;
    mapping(TaskId taskId => Case) private _cases;
    mapping(IOracleCommittee committee => mapping(uint8 seat => Deposit)) private _deposits;
    /// @inheritdoc IDisputes
    mapping(address account => uint256) public pendingPayments;

    constructor(IOrganization organization_) {
        organization = organization_;
        tasks = organization_.tasks();
        _services = organization_.services();
        _token = organization_.token();
    }

    /// @inheritdoc IDisputes
    function setInstances(bytes32 kind, Instance[] calldata instances) external {
        if (!IAccessControl(address(organization)).hasRole(ADMINISTRATOR, msg.sender)) {
            revert NotAdministrator(msg.sender);
        }
        if (instances.length == 0 || instances.length > MAX_INSTANCES) {
            revert InvalidInstances(kind, instances.length);
        }
        Instance[] storage all = _instances[kind].push();
        for (uint256 i = 0; i < instances.length; ++i) {
            _requireInstance(kind, instances, i);
            all.push(instances[i]);
        }
        uint256 longest = _longest(all);
        uint32 window = organization.kindOf(kind).minVerdictWindow;
        if (longest != 0 && window <= longest) revert VerdictWindowTooShort(kind, window, longest);
        emit InstancesChanged(kind, instances);
    }

    /// @inheritdoc IDisputes
    function postVotes(Vote calldata vote, string calldata reportUri, bytes calldata signatures) external {
        Task memory t = tasks.task(vote.taskId);
        Case storage c = _cases[vote.taskId];
        if (c.count != 0 && _isOver(t, c)) _void(vote.taskId, c);
        _requireVote(vote, reportUri, t);
        Instance[] storage all = c.count == 0 ? _begin(vote, t, c) : _go(vote, c, t.kind);
        uint8 number = c.count;
        IOracleCommittee committee = all[number].committee;
        uint64 voters = committee.countVoters(vote, signatures);
        _requireStakes(committee, voters, all[number].judgeStake);
        if (number + 1 == all.length || vote.verdict == Verdict.Undecided || t.verdictWindow < _longest(all))
        {
            _end(vote, reportUri, t, c, all);
            return;
        }
        uint256 until = block.timestamp + all[number].window;
        c.rulings[number] =
            Ruling(_content(vote, reportUri), vote.verdict, vote.amount.toUint96(), voters, address(0));
        (c.count, c.challenged, c.until) = (number + 1, false, until.toUint40());
        emit Ruled(vote.taskId, number, vote, reportUri, until);
    }

    /// @inheritdoc IDisputes
    function challenge(TaskId taskId, string calldata reason) external {
        Task memory t = tasks.task(taskId);
        Case storage c = _cases[taskId];
        if (c.count == 0 || _isOver(t, c)) revert NoCase(taskId);
        uint8 number = c.count - 1;
        Ruling storage ruling = c.rulings[number];
        if (c.challenged) revert ChallengedBefore(taskId, ruling.challenger);
        if (block.timestamp > c.until) revert WindowOver(taskId, c.until, block.timestamp);
        Texts.requireText(reason);
        Instance[] storage all = _instances[t.kind][c.version - 1];
        if (!_isParty(t, msg.sender) && !_isJudge(t.kind, all, msg.sender)) {
            revert NeitherPartyNorJudge(taskId, msg.sender);
        }
        uint256 until = block.timestamp + all[number + 1].decision;
        (c.challenged, c.until, ruling.challenger) = (true, until.toUint40(), msg.sender);
        uint256 stake = all[number].stake;
        emit Challenged(taskId, number, msg.sender, stake, until, reason);
        _take(stake);
    }

    /// @inheritdoc IDisputes
    function close(Vote calldata vote, string calldata reportUri) external {
        TaskId taskId = vote.taskId;
        Task memory t = tasks.task(taskId);
        Case storage c = _cases[taskId];
        if (c.count == 0) revert NoCase(taskId);
        if (_isOver(t, c)) {
            _void(taskId, c);
            return;
        }
        if (block.timestamp <= c.until) revert WindowNotOver(taskId, c.until, block.timestamp);
        Ruling storage standing = c.rulings[c.count - 1];
        bytes32 content = _content(vote, reportUri);
        if (content != standing.content) revert OtherVerdict(taskId, content, standing.content);
        Instance[] storage all = _instances[t.kind][c.version - 1];
        if (c.challenged) {
            // Who should have decided was silent, which is not the challenger's fault.
            address challenger = standing.challenger;
            (c.challenged, standing.challenger) = (false, address(0));
            _pay(taskId, challenger, all[c.count - 1].stake);
        }
        _end(vote, reportUri, t, c, all);
    }

    /// @inheritdoc IDisputes
    function withdrawPayments(address account) external {
        uint256 amount = pendingPayments[account];
        if (amount == 0) revert NothingOwed(account);
        pendingPayments[account] = 0;
        _token.safeTransfer(_services.payoutOf(account), amount);
    }

    /// @inheritdoc IDisputes
    function depositStake(IOracleCommittee committee, uint8 seat, uint256 amount) external {
        _ownerOf(committee, seat);
        Deposit storage d = _deposits[committee][seat];
        // All that a seat has fits into one word, whatever part of it leaves.
        d.stake = (amount + d.stake + d.leaving).toUint96() - d.leaving;
        emit StakeDeposited(committee, seat, msg.sender, amount);
        _take(amount);
    }

    /// @inheritdoc IDisputes
    function announceWithdrawal(IOracleCommittee committee, uint8 seat, uint256 amount) external {
        address owner = _ownerOf(committee, seat);
        if (msg.sender != owner) revert NotOwner(msg.sender, owner);
        Deposit storage d = _deposits[committee][seat];
        if (amount > d.stake) revert StakeTooLow(committee, seat, d.stake, amount);
        uint256 until = block.timestamp + UNBONDING;
        (d.stake, d.leaving, d.until) =
        (d.stake - uint96(amount), d.leaving + uint96(amount), until.toUint40());
        emit WithdrawalAnnounced(committee, seat, amount, until);
    }

    /// @inheritdoc IDisputes
    function withdrawStake(IOracleCommittee committee, uint8 seat) external {
        address owner = _ownerOf(committee, seat);
        Deposit storage d = _deposits[committee][seat];
        uint256 amount = d.leaving;
        if (amount == 0) revert NoWithdrawal(committee, seat);
        if (block.timestamp <= d.until) {
            revert WithdrawalTooEarly(committee, seat, d.until, block.timestamp);
        }
        (d.leaving, d.until) = (0, 0);
        address to = _services.payoutOf(owner);
        emit StakeWithdrawn(committee, seat, to, amount);
        _send(to, amount);
    }

    /// @inheritdoc IDisputes
    function instancesOf(bytes32 kind) external view returns (Instance[] memory none) {
        uint256 versions = _instances[kind].length;
        return versions == 0 ? none : _instances[kind][versions - 1];
    }

    /// @inheritdoc IDisputes
    function longestCase(bytes32 kind) external view returns (uint256) {
        uint256 versions = _instances[kind].length;
        return versions == 0 ? 0 : _longest(_instances[kind][versions - 1]);
    }

    /// @inheritdoc IDisputes
    function caseOf(TaskId taskId)
        external
        view
        returns (Ruling[] memory rulings, bool challenged, uint256 until)
    {
        Case storage c = _cases[taskId];
        rulings = new Ruling[](c.count);
        for (uint256 i = 0; i < c.count; ++i) {
            rulings[i] = c.rulings[i];
        }
        return (rulings, c.challenged, c.until);
    }

    /// @inheritdoc IDisputes
    function stakeOf(IOracleCommittee committee, uint8 seat)
        external
        view
        returns (uint256 stake, uint256 leaving, uint256 until)
    {
        Deposit storage d = _deposits[committee][seat];
        return (d.stake, d.leaving, d.until);
    }

    /// @dev The first ruling on an attempt, early enough for all that may follow. A task that was posted when its kind
    /// had shorter verdict windows is judged as then, at once.
    function _begin(Vote calldata vote, Task memory t, Case storage c)
        private
        returns (Instance[] storage all)
    {
        uint256 version = _instances[t.kind].length;
        if (version == 0) revert KindWithoutInstances(t.kind);
        all = _instances[t.kind][version - 1];
        uint256 longest = _longest(all);
        uint256 end = block.timestamp + longest;
        // What is left undecided goes to the auditors at once.
        bool challengeable = vote.verdict != Verdict.Undecided && t.verdictWindow >= longest;
        if (challengeable && end > t.deadline) revert TooLate(vote.taskId, end, t.deadline);
        (c.attempt, c.version) = (t.attempt, version.toUint32());
    }

    /// @dev A later ruling, on a challenge.
    function _go(Vote calldata vote, Case storage c, bytes32 kind)
        private
        view
        returns (Instance[] storage all)
    {
        if (!c.challenged) revert NotChallenged(vote.taskId);
        if (block.timestamp > c.until) revert WindowOver(vote.taskId, c.until, block.timestamp);
        if (vote.verdict == Verdict.Undecided) revert MustDecide(vote.taskId);
        return _instances[kind][c.version - 1];
    }

    /// @dev Post the verdict; who was wrong pays.
    function _end(
        Vote calldata vote,
        string calldata reportUri,
        Task memory t,
        Case storage c,
        Instance[] storage all
    ) private {
        uint256 count = c.count;
        address[] memory challengers = new address[](count);
        bool[] memory right = new bool[](count);
        // slither-disable-next-line uninitialized-local
        address winner;
        for (uint256 i = 0; i < count; ++i) {
            Ruling storage ruling = c.rulings[i];
            challengers[i] = ruling.challenger;
            if (challengers[i] == address(0)) continue;
            right[i] = _isRight(t, challengers[i], ruling, vote);
            if (right[i]) winner = challengers[i];
        }
        uint256 lost = _takeStakes(vote, c, all);
        _forget(c);
        if (lost != 0) _pay(vote.taskId, address(organization), lost);
        for (uint256 i = 0; i < count; ++i) {
            address challenger = challengers[i];
            if (challenger == address(0)) continue;
            address to = challenger;
            if (!right[i]) to = winner == address(0) ? _against(t, challenger) : winner;
            _pay(vote.taskId, to, all[i].stake);
        }
        emit CaseClosed(vote.taskId, vote.attempt, vote.verdict, vote.amount);
        _post(vote, reportUri);
    }

    /// @dev Who voted for what was overturned loses its stake, or what is left of it: first what counts for votes.
    /// @return lost by all of them together
    function _takeStakes(Vote calldata vote, Case storage c, Instance[] storage all)
        private
        returns (uint256 lost)
    {
        for (uint256 i = 0; i < c.count; ++i) {
            if (!_isOverturned(c.rulings[i], vote)) continue;
            uint96 judgeStake = all[i].judgeStake;
            if (judgeStake == 0) continue;
            uint64 voters = c.rulings[i].voters;
            for (uint8 seat = 0; voters >> seat != 0; ++seat) {
                if ((voters >> seat) & 1 == 1) {
                    lost += _takeStake(vote.taskId, all[i].committee, seat, judgeStake);
                }
            }
        }
    }

    function _takeStake(TaskId taskId, IOracleCommittee committee, uint8 seat, uint96 judgeStake)
        private
        returns (uint96 amount)
    {
        Deposit storage d = _deposits[committee][seat];
        uint96 staked = judgeStake < d.stake ? judgeStake : d.stake;
        uint96 rest = judgeStake - staked;
        uint96 leaving = rest < d.leaving ? rest : d.leaving;
        amount = staked + leaving;
        if (amount == 0) return 0;
        (d.stake, d.leaving) = (d.stake - staked, d.leaving - leaving);
        emit StakeLost(taskId, committee, seat, amount);
    }

    function _post(Vote calldata vote, string calldata reportUri) private {
        // The votes were counted before.
        // slither-disable-next-line unused-return
        tasks.postVerdict(
            vote.taskId,
            vote.attempt,
            vote.proofHash,
            vote.verdict,
            vote.amount,
            vote.reportHash,
            reportUri,
            vote.reason
        );
    }

    /// @dev The attempt is over without a verdict from here.
    function _void(TaskId taskId, Case storage c) private {
        Instance[] storage all = _instances[tasks.task(taskId).kind][c.version - 1];
        uint256 count = c.count;
        address[] memory challengers = new address[](count);
        for (uint256 i = 0; i < count; ++i) {
            challengers[i] = c.rulings[i].challenger;
        }
        emit CaseVoided(taskId, c.attempt);
        _forget(c);
        for (uint256 i = 0; i < count; ++i) {
            if (challengers[i] != address(0)) _pay(taskId, challengers[i], all[i].stake);
        }
    }

    function _forget(Case storage c) private {
        for (uint256 i = 0; i < c.count; ++i) {
            delete c.rulings[i];
        }
        (c.attempt, c.version, c.count, c.challenged, c.until) = (0, 0, 0, false, 0);
    }

    function _pay(TaskId taskId, address account, uint256 amount) private {
        address to = _services.payoutOf(account);
        emit StakePaid(taskId, to, amount);
        _send(to, amount);
    }

    /// @dev All of `amount` arrives from the caller, or nothing happened: else stakes of others would pay for it.
    function _take(uint256 amount) private {
        uint256 before = _token.balanceOf(address(this));
        _token.safeTransferFrom(msg.sender, address(this), amount);
        uint256 received = _token.balanceOf(address(this)) - before;
        if (received != amount) revert ITaskManager.WrongAmountReceived(amount, received);
    }

    /// @dev A token that refuses holds up no case, and neither does a recipient that the token calls.
    function _send(address to, uint256 amount) private {
        if (Payments.pay(_token, to, amount)) return;
        pendingPayments[to] += amount;
        emit StakeDeferred(to, amount);
    }

    /// @dev What the task manager would refuse at the end is refused now.
    function _requireVote(Vote calldata vote, string calldata reportUri, Task memory t) private view {
        TaskId taskId = vote.taskId;
        if (t.state != TaskState.Submitted) {
            revert ITaskManager.WrongState(taskId, t.state, TaskState.Submitted);
        }
        if (vote.attempt != t.attempt) revert ITaskManager.WrongAttempt(taskId, t.attempt, vote.attempt);
        if (block.timestamp > t.deadline) {
            revert ITaskManager.DeadlinePassed(taskId, t.deadline, block.timestamp);
        }
        if (vote.proofHash != t.proofHash) {
            revert ITaskManager.ProofMismatch(taskId, t.proofHash, vote.proofHash);
        }
        if (vote.verdict == Verdict.None) revert ITaskManager.NoVerdict(taskId);
        uint256 max = vote.verdict == Verdict.Accepted ? t.price : 0;
        if (vote.amount > max || (vote.amount == 0 && max != 0)) {
            revert ITaskManager.InvalidAmount(taskId, vote.amount, max);
        }
        Texts.requireText(reportUri);
        Texts.requireText(vote.reason);
    }

    function _requireInstance(bytes32 kind, Instance[] calldata instances, uint256 i) private view {
        Instance calldata one = instances[i];
        bool last = i + 1 == instances.length;
        bool windows = last
            ? one.window == 0 && one.stake == 0 && one.judgeStake == 0
            : one.stake != 0 && one.window >= MIN_WINDOW && one.window <= MAX_WINDOW;
        bool decision = i == 0 ? one.decision == 0 : one.decision >= MIN_WINDOW && one.decision <= MAX_WINDOW;
        bool ours = one.committee.organization() == organization;
        if (!windows || !decision || !ours) revert InvalidInstances(kind, i);
        Quorum memory quorum = one.committee.quorumOf(kind);
        if (i == 0) return;
        Instance calldata below = instances[i - 1];
        if (quorum.votes <= below.committee.quorumOf(kind).votes || (!last && one.stake <= below.stake)) {
            revert InvalidInstances(kind, i);
        }
        for (uint256 j = 0; j < i; ++j) {
            _requireOthers(kind, one.committee, quorum.judges, instances[j].committee);
        }
    }

    /// @dev None of the seats `judges` of one committee is held by a judge of the other.
    function _requireOthers(bytes32 kind, IOracleCommittee one, uint64 judges, IOracleCommittee other)
        private
        view
    {
        for (uint8 seat = 0; judges >> seat != 0; ++seat) {
            if ((judges >> seat) & 1 == 0) continue;
            address key = one.keyOf(seat);
            if (other.judge(key).owner != address(0)) revert JudgesTwice(kind, key);
        }
    }

    /// @dev Each of the seats `voters` has staked what its vote needs.
    function _requireStakes(IOracleCommittee committee, uint64 voters, uint96 needed) private view {
        if (needed == 0) return;
        for (uint8 seat = 0; voters >> seat != 0; ++seat) {
            if ((voters >> seat) & 1 == 0) continue;
            uint256 stake = _deposits[committee][seat].stake;
            if (stake < needed) revert StakeTooLow(committee, seat, stake, needed);
        }
    }

    /// @dev For whom the judge works who has this seat, as `committee` says. Whoever deposits for a judge of a contract that
    /// is no committee of the organization has that contract decide about this deposit, and about no other.
    function _ownerOf(IOracleCommittee committee, uint8 seat) private view returns (address owner) {
        owner = committee.judge(committee.keyOf(seat)).owner;
        if (owner == address(0)) revert NoJudge(committee, seat);
    }

    /// @dev Whether the attempt that the case is about waits for a verdict no more.
    function _isOver(Task memory t, Case storage c) private view returns (bool) {
        return t.state != TaskState.Submitted || t.attempt != c.attempt || block.timestamp > t.deadline;
    }

    function _isParty(Task memory t, address account) private view returns (bool) {
        return _speaksFor(account, t.creator) || _speaksFor(account, _services.providerOf(t.serviceId));
    }

    /// @dev An operator stands for the organization.
    function _speaksFor(address account, address party) private view returns (bool) {
        if (account == party) return true;
        return
            party == address(organization) && IAccessControl(address(organization)).hasRole(OPERATOR, account);
    }

    /// @dev Whether the end is what the challenger wanted: for a party better than the ruling, for a judge another one.
    function _isRight(Task memory t, address challenger, Ruling storage ruling, Vote calldata vote)
        private
        view
        returns (bool)
    {
        if (!_isOverturned(ruling, vote)) return false;
        bool ofCreator = _speaksFor(challenger, t.creator);
        if (ofCreator == _speaksFor(challenger, _services.providerOf(t.serviceId))) return true;
        (uint256 before, uint256 then) =
            (_worth(t, ruling.verdict, ruling.amount), _worth(t, vote.verdict, vote.amount));
        return ofCreator ? then < before : then > before;
    }

    /// @dev To the executor, for comparing: what it is paid, and in two bits what it is known for, if that is the same.
    function _worth(Task memory t, Verdict verdict, uint256 amount) private view returns (uint256) {
        if (verdict == Verdict.Accepted) return amount << 2 | 2;
        return verdict == Verdict.Impossible ? t.price / tasks.IMPOSSIBLE_SHARE() << 2 | 1 : 0;
    }

    function _isJudge(bytes32 kind, Instance[] storage all, address account) private view returns (bool) {
        for (uint256 i = 0; i < all.length; ++i) {
            IOracleCommittee committee = all[i].committee;
            uint64 judges = committee.quorumOf(kind).judges;
            if (committee.judge(account).owner != address(0)) {
                if ((judges >> committee.judge(account).seat) & 1 == 1) return true;
            }
        }
        return false;
    }

    /// @dev Whom a challenge of `challenger` kept waiting: the other party. A judge or an operator pays the party that
    /// is not the organization, and the organization if it is none.
    function _against(Task memory t, address challenger) private view returns (address) {
        address ours = address(organization);
        address executor = _services.providerOf(t.serviceId);
        if (challenger == executor) return t.creator;
        if (challenger == t.creator || t.creator == ours) return executor;
        return executor == ours ? t.creator : ours;
    }

    /// @dev All windows after the first verdict, and the first one again, in which somebody calls close.
    function _longest(Instance[] storage all) private view returns (uint256 time) {
        for (uint256 i = 0; i < all.length; ++i) {
            time += uint256(all[i].window) + all[i].decision;
        }
        time += all[0].window;
    }

    /// @dev Another amount is another verdict.
    function _isOverturned(Ruling storage ruling, Vote calldata end) private view returns (bool) {
        return ruling.verdict != end.verdict || ruling.amount != end.amount;
    }

    function _content(Vote calldata vote, string calldata reportUri) private pure returns (bytes32) {
        return keccak256(abi.encode(vote, reportUri));
    }
}
