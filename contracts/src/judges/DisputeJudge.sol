// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20} from "@openzeppelin/contracts/token/ERC20/IERC20.sol";
import {SafeERC20} from "@openzeppelin/contracts/token/ERC20/utils/SafeERC20.sol";
import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {ICommitteeJudge, Quorum, Seat} from "../interfaces/ICommitteeJudge.sol";
import {IDisputeJudge, Instance, InstanceRuling} from "../interfaces/IDisputeJudge.sol";
import {Finding, IJudge} from "../interfaces/IJudge.sol";
import {IOrganization, MAX_CASE, MAX_KINDS, MIN_WINDOW} from "../interfaces/IOrganization.sol";
import {IMPOSSIBLE_SHARE, Ruling, Task} from "../interfaces/ITaskManager.sol";
import {Relayed} from "../libraries/Relayed.sol";
import {Payments} from "../libraries/Payments.sol";
import {Texts} from "../libraries/Texts.sol";
import {KindId} from "../types/KindId.sol";
import {OPERATOR_ROLE} from "../types/Roles.sol";
import {unpackService} from "../types/ServiceId.sol";
import {TaskId} from "../types/TaskId.sol";
import {Judge} from "./Judge.sol";

contract DisputeJudge is IDisputeJudge, Judge {
    using SafeCast for uint256;
    using SafeERC20 for IERC20;

    /// @dev A case is kept here, because the task manager forgets the attempt: a word, and two for each ruling.
    /// @param version which of the kind's lists of instances the case began with, counted from 1
    /// @param count how many instances have ruled
    /// @param challenged the last ruling is before the next instance
    /// @param settled its stakes are free or paid
    struct Case {
        address creator;
        uint32 serviceId;
        KindId kindId;
        uint24 version;
        uint8 count;
        bool challenged;
        bool settled;
        InstanceRuling[3] rulings;
    }

    /// @dev The stake of a judge; see stakeOf.
    struct Deposit {
        uint96 stake;
        uint96 leaving;
        uint40 until;
        uint128 open;
    }

    /// @dev A committee, the one above it, and one appeal: as many as a Case has rulings.
    uint256 private constant MAX_INSTANCES = 3;
    /// @dev Two of them, and as long for the answers, are a case.
    uint32 private constant MAX_WINDOW = 7 days;
    /// @notice A stake stands for so many times as much that open rulings pay.
    uint256 public constant STAKE_COVERS = 10;
    /// @dev How long a judge's stake can still be lost after it was announced to leave: as long as a case may last.
    uint32 private constant UNBONDING = 30 days;

    IERC20 private immutable _token;
    /// @dev For `challenge` alone.
    address private immutable _forwarder;

    mapping(bytes32 kind => Instance[][]) private _instances;
    mapping(TaskId taskId => mapping(uint8 attempt => Case)) private _cases;
    mapping(ICommitteeJudge committee => mapping(uint8 seat => Deposit)) private _deposits;
    /// @inheritdoc IDisputeJudge
    mapping(address account => uint256) public pendingPayments;

    constructor(IOrganization organization_, address next_) Judge(organization_, next_) {
        (_token, _forwarder) = (organization_.token(), tasks.signedRequests());
    }

    /// @inheritdoc IDisputeJudge
    function setInstances(bytes32 kind, Instance[] calldata instances) external onlyAdministrator {
        if (instances.length == 0 || instances.length > MAX_INSTANCES) {
            revert InvalidInstances(kind, instances.length);
        }
        uint256 window = _windowOf(kind);
        Instance[] storage all = _instances[kind].push();
        for (uint256 i = 0; i < instances.length; ++i) {
            _requireInstance(kind, instances, i);
            all.push(instances[i]);
        }
        uint256 longest = _longest(all);
        if (_windowFor(longest) > window) revert CaseTooLong(kind, longest, window);
        emit InstancesChanged(kind, instances);
    }

    /// @inheritdoc IDisputeJudge
    function postVotes(Finding calldata f, string calldata reportUri, bytes calldata signatures) external {
        Task memory a = _case(f.taskId);
        Case storage c = _cases[f.taskId][f.attempt];
        Instance[] storage all = c.count == 0 ? _begin(f, a, c) : _go(f, c);
        uint248 by = _voters(f, a.kindId, c, all, signatures);
        _find(f, reportUri, _keep(f, a.price, c, all, uint64(by)));
        _remember(f, by);
    }

    /// @inheritdoc IDisputeJudge
    function challenge(TaskId taskId, uint8 attempt, uint8 instance, string calldata reason) external {
        Task memory a = _case(taskId);
        Case storage c = _cases[taskId][a.attempt];
        if (c.count == 0 || c.settled) revert NoCase(taskId, a.attempt);
        if (attempt != a.attempt || instance + 1 != c.count) {
            revert AnotherRuling(taskId, a.attempt, c.count - 1);
        }
        InstanceRuling storage last = c.rulings[instance];
        if (block.timestamp > last.windowEnd) revert WindowOver(taskId, last.windowEnd, block.timestamp);
        Texts.requireText(reason);
        Instance[] storage all = _allOf(c);
        address challenger = Relayed.sender(_forwarder);
        address before = _requireChallenger(taskId, c, challenger);
        if (before == address(0)) {
            c.challenged = true;
            last.until = (block.timestamp + all[instance + 1].decision).toUint40();
            _ruleAgain(taskId, a, last);
        }
        last.challenger = challenger;
        uint256 stake = all[instance].stake;
        emit Challenged(taskId, instance, challenger, stake, last.until, reason);
        _take(challenger, stake);
        if (before != address(0)) _pay(taskId, before, stake);
    }

    /// @inheritdoc IDisputeJudge
    function settle(TaskId taskId, uint8 attempt) external {
        Case storage c = _cases[taskId][attempt];
        if (c.count == 0 || c.settled) revert NoCase(taskId, attempt);
        bool voided = tasks.isRemoved(c.kindId);
        InstanceRuling memory end = c.rulings[c.count - 1];
        if (!voided && block.timestamp <= end.until) {
            revert WindowNotOver(taskId, end.until, block.timestamp);
        }
        c.settled = true;
        emit CaseSettled(taskId, attempt, voided);
        Instance[] storage all = _allOf(c);
        if (c.challenged) {
            // Who should have decided was silent, which is not the challenger's fault.
            c.rulings[c.count - 1].challenger = address(0);
            _pay(taskId, end.challenger, all[c.count - 1].stake);
        }
        uint256 lost = 0;
        for (uint8 i = 0; i < c.count; ++i) {
            lost += _settle(taskId, c, all[i], c.rulings[i], end, voided);
            delete c.rulings[i];
        }
        if (lost != 0) _pay(taskId, address(organization), lost);
    }

    /// @inheritdoc IDisputeJudge
    function withdrawPayments(address account) external {
        uint256 amount = pendingPayments[account];
        if (amount == 0) revert NothingOwed(account);
        pendingPayments[account] = 0;
        _token.safeTransfer(_providers.payoutOf(account), amount);
    }

    /// @inheritdoc IDisputeJudge
    function payOrRevert(address to, uint256 amount) external {
        if (msg.sender != address(this)) revert NotItself(msg.sender);
        _token.safeTransfer(to, amount);
    }

    /// @inheritdoc IDisputeJudge
    function depositStake(ICommitteeJudge committee, uint8 seat, uint256 amount) external {
        _ownerOf(committee, seat);
        Deposit storage d = _deposits[committee][seat];
        // What leaves and what stays fit into one word together.
        d.stake = (amount + d.stake + d.leaving).toUint96() - d.leaving;
        emit StakeDeposited(committee, seat, msg.sender, amount);
        _take(msg.sender, amount);
    }

    /// @inheritdoc IDisputeJudge
    function announceWithdrawal(ICommitteeJudge committee, uint8 seat, uint256 amount) external {
        address owner = _ownerOf(committee, seat);
        if (msg.sender != owner) revert NotOwner(msg.sender, owner);
        Deposit storage d = _deposits[committee][seat];
        uint256 needed = amount + _locked(d);
        if (needed > d.stake) revert StakeTooLow(committee, seat, d.stake, needed);
        uint256 until = block.timestamp + UNBONDING;
        (d.stake, d.leaving, d.until) =
        (d.stake - uint96(amount), d.leaving + uint96(amount), until.toUint40());
        emit WithdrawalAnnounced(committee, seat, amount, until);
    }

    /// @inheritdoc IDisputeJudge
    function withdrawStake(ICommitteeJudge committee, uint8 seat) external {
        address owner = _ownerOf(committee, seat);
        Deposit storage d = _deposits[committee][seat];
        uint256 amount = d.leaving;
        if (amount == 0) revert NoWithdrawal(committee, seat);
        if (block.timestamp <= d.until) {
            revert WithdrawalTooEarly(committee, seat, d.until, block.timestamp);
        }
        (d.leaving, d.until) = (0, 0);
        address to = _providers.payoutOf(owner);
        emit StakeWithdrawn(committee, seat, to, amount);
        _send(to, amount);
    }

    /// @inheritdoc IJudge
    function termsFor(bytes32 kind) external view returns (bytes4, uint32, uint32) {
        Instance[] storage all = _latest(kind);
        for (uint256 i = 0; i < all.length; ++i) {
            _requireQuorum(kind, i, all[i].committee);
        }
        return (IJudge.termsFor.selector, uint32(_windowFor(_longest(all))), MAX_CASE);
    }

    /// @inheritdoc IDisputeJudge
    function instancesOf(bytes32 kind) external view returns (Instance[] memory none) {
        uint256 versions = _instances[kind].length;
        return versions == 0 ? none : _instances[kind][versions - 1];
    }

    /// @inheritdoc IDisputeJudge
    function longestCase(bytes32 kind) external view returns (uint256) {
        return _longest(_latest(kind));
    }

    /// @inheritdoc IDisputeJudge
    function caseOf(TaskId taskId, uint8 attempt)
        external
        view
        returns (InstanceRuling[] memory rulings, bool challenged, uint256 until)
    {
        Case storage c = _cases[taskId][attempt];
        rulings = new InstanceRuling[](c.settled ? 0 : c.count);
        for (uint256 i = 0; i < rulings.length; ++i) {
            rulings[i] = c.rulings[i];
            until = rulings[i].until;
        }
        challenged = c.challenged;
    }

    /// @inheritdoc IDisputeJudge
    function stakeOf(ICommitteeJudge committee, uint8 seat)
        external
        view
        returns (uint256 stake, uint256 open, uint256 leaving, uint256 until)
    {
        Deposit storage d = _deposits[committee][seat];
        return (d.stake, d.open, d.leaving, d.until);
    }

    /// @dev The first ruling on an attempt, early enough for all that may follow: so no later window ends after the case.
    function _begin(Finding calldata f, Task memory a, Case storage c)
        private
        returns (Instance[] storage all)
    {
        bytes32 kind = organization.kindNumbered(a.kindId);
        all = _latest(kind);
        if (f.ruling == Ruling.None) return all;
        uint256 end = block.timestamp + _longest(all);
        if (end > a.caseEnd) revert TooLate(f.taskId, end, a.caseEnd);
        (c.creator, c.serviceId, c.kindId) = (a.creator, a.serviceId.pack(), a.kindId);
        c.version = _instances[kind].length.toUint24();
    }

    /// @dev The votes of the instance whose turn it is. Nobody decides about what itself has said, whatever keys, owners and
    /// quorums have changed meanwhile.
    /// @return by its committee, and below it the voters: see _isAmong
    function _voters(
        Finding calldata f,
        KindId kindId,
        Case storage c,
        Instance[] storage all,
        bytes calldata signatures
    ) private view returns (uint248 by) {
        ICommitteeJudge committee = all[c.count].committee;
        uint64 voters = committee.votersOf(f, signatures);
        for (uint256 i = 0; i < c.count; ++i) {
            bytes32 kind = organization.kindNumbered(kindId);
            _requireOthers(kind, committee, voters, all[i].committee, c.rulings[i].voters);
        }
        return uint248(uint160(address(committee))) << 64 | voters;
    }

    /// @dev A later ruling, on a challenge.
    function _go(Finding calldata f, Case storage c) private view returns (Instance[] storage) {
        if (!c.challenged || c.settled) revert NotChallenged(f.taskId);
        uint256 until = c.rulings[c.count - 1].until;
        if (block.timestamp > until) revert WindowOver(f.taskId, until, block.timestamp);
        if (f.ruling == Ruling.None) revert MustDecide(f.taskId);
        return _allOf(c);
    }

    /// @dev The ruling of an instance is kept.
    /// @return until how long it stands
    function _keep(Finding calldata f, uint96 price, Case storage c, Instance[] storage all, uint64 voters)
        private
        returns (uint256 until)
    {
        uint8 number = c.count;
        if (f.ruling != Ruling.None) {
            uint96 paid = f.ruling == Ruling.Impossible ? uint96(price / IMPOSSIBLE_SHARE) : f.amount;
            if (number + 1 < all.length) {
                until = block.timestamp + all[number].window;
                _lock(all[number], voters, paid);
            }
            uint40 end = until.toUint40();
            c.rulings[number] =
                InstanceRuling(f.reportHash, f.ruling, f.fault, paid, voters, end, end, address(0));
            (c.count, c.challenged) = (number + 1, false);
        }
        emit InstanceRuled(f.taskId, f.attempt, number, f.ruling, f.rulesHash, voters, until);
    }

    /// @dev The account may challenge the last ruling, or take the challenge over.
    /// @return before from whom; 0 if nobody has challenged it
    function _requireChallenger(TaskId taskId, Case storage c, address account)
        private
        view
        returns (address before)
    {
        bool party = _isParty(c, account);
        if (!party && !_isJudge(c, account)) revert NeitherPartyNorJudge(taskId, account);
        before = c.rulings[c.count - 1].challenger;
        if (before != address(0) && (!party || _isParty(c, before))) revert ChallengedBefore(taskId, before);
    }

    /// @dev The same ruling stands longer, so that the next instance has time.
    function _ruleAgain(TaskId taskId, Task memory a, InstanceRuling memory r) private {
        uint96 amount = r.ruling == Ruling.Accepted ? r.paid : 0;
        // slither-disable-next-line unused-return
        tasks.rule(taskId, a.attempt, a.proofHash, r.ruling, r.fault, amount, r.until, r.reportHash);
    }

    /// @dev Each voter has staked enough: what its instance asks for, and a tenth of what its open rulings pay.
    /// @param paid by the ruling
    function _lock(Instance storage one, uint64 voters, uint96 paid) private {
        (uint96 needed, ICommitteeJudge committee) = (one.judgeStake, one.committee);
        if (needed == 0) return;
        for (uint8 seat = 0; voters >> seat != 0; ++seat) {
            if ((voters >> seat) & 1 == 0) continue;
            Deposit storage d = _deposits[committee][seat];
            if (d.stake < needed) revert StakeTooLow(committee, seat, d.stake, needed);
            if (paid == 0) continue;
            d.open += paid;
            if (_locked(d) > d.stake) revert StakeTooLow(committee, seat, d.stake, _locked(d));
        }
    }

    /// @dev Settle one ruling of a case that is over: whoever was wrong pays.
    /// @return lost by its judges together
    function _settle(
        TaskId taskId,
        Case storage c,
        Instance storage one,
        InstanceRuling memory r,
        InstanceRuling memory end,
        bool voided
    ) private returns (uint256 lost) {
        bool overturned = !voided && _isOverturned(r, end);
        // The last instance has staked nothing.
        if (one.judgeStake != 0) lost = _free(taskId, one, r, overturned);
        if (r.challenger == address(0)) return lost;
        if (voided || (overturned && _isRight(c, r, end))) {
            _pay(taskId, r.challenger, one.stake);
            return lost;
        }
        address other = _against(c, r);
        uint256 stake = one.stake;
        if (other != address(organization) && _ownsJudge(c, other)) {
            _pay(taskId, address(organization), stake - stake / 2);
            stake /= 2;
        }
        _pay(taskId, other, stake);
    }

    /// @dev The judges of a ruling have its stake free again, or lose it: first what counts for votes, of a ruling that pays
    /// nothing only what is free, then what leaves.
    function _free(TaskId taskId, Instance storage one, InstanceRuling memory r, bool overturned)
        private
        returns (uint256 lost)
    {
        for (uint8 seat = 0; r.voters >> seat != 0; ++seat) {
            if ((r.voters >> seat) & 1 == 0) continue;
            Deposit storage d = _deposits[one.committee][seat];
            d.open -= r.paid;
            if (overturned) lost += _lose(taskId, one, seat, d, r.paid != 0);
        }
    }

    function _lose(TaskId taskId, Instance storage one, uint8 seat, Deposit storage d, bool locked)
        private
        returns (uint96 amount)
    {
        (uint256 stake, uint256 kept) = (d.stake, locked ? 0 : _locked(d));
        uint96 free = uint96(stake > kept ? stake - kept : 0);
        uint96 staked = one.judgeStake < free ? one.judgeStake : free;
        uint96 rest = one.judgeStake - staked;
        uint96 leaving = rest < d.leaving ? rest : d.leaving;
        amount = staked + leaving;
        if (amount == 0) return 0;
        (d.stake, d.leaving) = (d.stake - staked, d.leaving - leaving);
        emit StakeLost(taskId, one.committee, seat, amount);
    }

    function _pay(TaskId taskId, address account, uint256 amount) private {
        address to = _providers.payoutOf(account);
        emit StakePaid(taskId, to, amount);
        _send(to, amount);
    }

    /// @dev All of `amount` arrives, or nothing happened: else stakes of others would pay for it.
    function _take(address from, uint256 amount) private {
        uint256 before = _token.balanceOf(address(this));
        // The caller, or who signed the challenge.
        // slither-disable-next-line arbitrary-send-erc20
        _token.safeTransferFrom(from, address(this), amount);
        uint256 received = _token.balanceOf(address(this)) - before;
        if (received != amount) revert WrongStakeReceived(amount, received);
    }

    /// @dev A token that refuses holds up no case, and neither does a recipient that the token calls. A refused payment is
    /// undone, also where the token had moved it: otherwise others' stakes would pay it again.
    function _send(address to, uint256 amount) private {
        try this.payOrRevert{gas: Payments.GAS}(to, amount) {}
        catch {
            pendingPayments[to] += amount;
            emit StakeDeferred(to, amount);
        }
    }

    /// @dev Each instance has a quorum, and time to be challenged and to answer; the next one has more votes, and a greater
    /// stake, and other judges.
    function _requireInstance(bytes32 kind, Instance[] calldata instances, uint256 i) private view {
        Instance calldata one = instances[i];
        bool last = i + 1 == instances.length;
        bool windows = last
            ? one.window == 0 && one.stake == 0 && one.judgeStake == 0
            : one.stake != 0 && one.window >= MIN_WINDOW && one.window <= MAX_WINDOW;
        bool decision = i == 0 ? one.decision == 0 : one.decision >= MIN_WINDOW && one.decision <= MAX_WINDOW;
        if (!windows || !decision || Judge(address(one.committee)).organization() != organization) {
            revert InvalidInstances(kind, i);
        }
        Quorum memory quorum = _requireQuorum(kind, i, one.committee);
        for (uint256 j = 0; j < i; ++j) {
            Instance calldata below = instances[j];
            Quorum memory others = below.committee.quorumOf(kind);
            if (quorum.votes <= others.votes || (!last && one.stake <= below.stake)) {
                revert InvalidInstances(kind, i);
            }
            _requireOthers(kind, one.committee, quorum.seats, below.committee, others.seats);
        }
    }

    /// @dev None of these seats of one committee is held by a judge who has one of the others' seats, nor by one of the same
    /// owner.
    function _requireOthers(
        bytes32 kind,
        ICommitteeJudge one,
        uint64 seats,
        ICommitteeJudge other,
        uint64 others
    ) private view {
        for (uint8 i = 0; seats >> i != 0; ++i) {
            if ((seats >> i) & 1 == 0) continue;
            address key = one.keyOf(i);
            address owner = one.seatOf(key).owner;
            if (other.includes(others, key) || (owner != key && other.includes(others, owner))) {
                revert JudgesTwice(kind, key);
            }
        }
    }

    function _requireQuorum(bytes32 kind, uint256 i, ICommitteeJudge committee)
        private
        view
        returns (Quorum memory quorum)
    {
        quorum = committee.quorumOf(kind);
        if (quorum.votes == 0) revert InvalidInstances(kind, i);
    }

    /// @dev For whom the judge works who has this seat, as `committee` says. Whoever deposits for a judge of a contract that
    /// is no committee of the organization has that contract decide about this deposit, and about no other.
    function _ownerOf(ICommitteeJudge committee, uint8 seat) private view returns (address owner) {
        owner = committee.seatOf(committee.keyOf(seat)).owner;
        if (owner == address(0)) revert NoJudge(committee, seat);
    }

    /// @dev The verdict window into which a case has to fit. Of the present number the organization knows what this contract
    /// asked for; tasks of an earlier one have at least what it would ask for now, because later lists were no longer.
    function _windowOf(bytes32 kind) private view returns (uint256) {
        if (_judges(organization.numberOf(kind))) return organization.kindOf(kind).judgesWindow;
        for (uint256 i = 1; i <= MAX_KINDS; ++i) {
            KindId number = KindId.wrap(uint8(i));
            bytes32 numbered = organization.kindNumbered(number);
            if (numbered == 0) break;
            if (numbered == kind && _judges(number)) return _windowFor(_longest(_latest(kind)));
        }
        return _windowFor(MAX_CASE);
    }

    function _judges(KindId number) private view returns (bool) {
        return address(organization.judgeNumbered(number)) == address(this) && !tasks.isRemoved(number);
    }

    function _latest(bytes32 kind) private view returns (Instance[] storage) {
        uint256 versions = _instances[kind].length;
        if (versions == 0) revert KindWithoutInstances(kind);
        return _instances[kind][versions - 1];
    }

    function _allOf(Case storage c) private view returns (Instance[] storage) {
        return _instances[organization.kindNumbered(c.kindId)][c.version - 1];
    }

    function _isParty(Case storage c, address account) private view returns (bool) {
        return _speaksFor(account, c.creator) || _speaksFor(account, _executorOf(c));
    }

    function _executorOf(Case storage c) private view returns (address) {
        return _services.providerOf(unpackService(c.serviceId));
    }

    /// @dev A device speaks for its owner, an owner for its devices, and an operator for the organization.
    function _speaksFor(address account, address party) private view returns (bool) {
        if (_providers.areRelated(account, party)) return true;
        return party == address(organization) && _hasRole(OPERATOR_ROLE, account);
    }

    /// @dev Whether the end is what the challenger wanted: for a party better than the ruling, for a judge another one.
    function _isRight(Case storage c, InstanceRuling memory r, InstanceRuling memory end)
        private
        view
        returns (bool)
    {
        bool ofCreator = _speaksFor(r.challenger, c.creator);
        if (ofCreator == _speaksFor(r.challenger, _executorOf(c))) return true;
        return ofCreator ? _worth(end) < _worth(r) : _worth(end) > _worth(r);
    }

    /// @dev A wrong challenge kept the other party waiting. A ruling that a judge challenged was to the good of the executor
    /// if it pays, else of the creator.
    function _against(Case storage c, InstanceRuling memory r) private view returns (address) {
        address executor = _executorOf(c);
        bool ofCreator = _speaksFor(r.challenger, c.creator);
        if (ofCreator != _speaksFor(r.challenger, executor)) return ofCreator ? executor : c.creator;
        return r.paid != 0 ? executor : c.creator;
    }

    function _isJudge(Case storage c, address account) private view returns (bool) {
        Instance[] storage all = _allOf(c);
        bytes32 kind = organization.kindNumbered(c.kindId);
        for (uint256 i = 0; i < all.length; ++i) {
            ICommitteeJudge committee = all[i].committee;
            Seat memory seat = committee.seatOf(account);
            if (seat.owner == address(0)) continue;
            if ((committee.quorumOf(kind).seats >> seat.number) & 1 == 1) return true;
        }
        return false;
    }

    /// @dev Whether one of the judges of the case is the party's, by its key or its owner.
    function _ownsJudge(Case storage c, address party) private view returns (bool) {
        bytes32 kind = organization.kindNumbered(c.kindId);
        Instance[] storage all = _allOf(c);
        for (uint256 i = 0; i < all.length; ++i) {
            ICommitteeJudge committee = all[i].committee;
            if (committee.includes(committee.quorumOf(kind).seats, party)) return true;
        }
        return false;
    }

    /// @inheritdoc Judge
    function _isAmong(uint248 by, address account) internal view override returns (bool) {
        return ICommitteeJudge(address(uint160(by >> 64))).includes(uint64(by), account);
    }

    /// @dev All windows and answers after the first ruling.
    function _longest(Instance[] storage all) private view returns (uint256 time) {
        for (uint256 i = 0; i < all.length; ++i) {
            time += uint256(all[i].window) + all[i].decision;
        }
    }

    /// @dev The part of the stake that stands for what open rulings pay.
    function _locked(Deposit storage d) private view returns (uint256) {
        return (d.open + STAKE_COVERS - 1) / STAKE_COVERS;
    }

    /// @dev The shortest verdict window in which there is time for the first ruling, and for all that may follow.
    function _windowFor(uint256 longest) private pure returns (uint256) {
        return longest + MIN_WINDOW;
    }

    /// @dev Another amount is another ruling.
    function _isOverturned(InstanceRuling memory r, InstanceRuling memory end) private pure returns (bool) {
        return r.ruling != end.ruling || r.paid != end.paid;
    }

    /// @dev To the executor, for comparing: what it is paid, and in three bits what it is known for, if that is the same. To
    /// have given up may cost it the penalty, and a void costs nobody anything.
    function _worth(InstanceRuling memory r) private pure returns (uint256) {
        uint256 known = 0;
        if (r.ruling == Ruling.Accepted) known = 4;
        else if (r.ruling == Ruling.Impossible) known = 3;
        else if (r.ruling == Ruling.Void) known = 2;
        else if (r.ruling == Ruling.GivenUp) known = 1;
        return uint256(r.paid) << 3 | known;
    }
}
