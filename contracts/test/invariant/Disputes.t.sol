// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {InstanceRuling} from "../../src/interfaces/IDisputeJudge.sol";
import {Finding} from "../../src/interfaces/IJudge.sol";
import {Ruling, TaskRequest, TaskState} from "../../src/interfaces/ITaskManager.sol";
import {CommitteeJudge} from "../../src/judges/CommitteeJudge.sol";
import {TaskId} from "../../src/types/TaskId.sol";
import {Instances} from "../Instances.sol";

/// @notice Whole cases, in which everybody acts at any time and in any way.
contract DisputesInvariants is Instances {
    /// @dev What happened in a case: what each instance said, who challenged it, and whether another took that over.
    struct Course {
        TaskId taskId;
        Finding[3] said;
        uint256 rulings;
        address[2] challengers;
        bool silent;
    }

    address[4] private _people;
    uint256 private _wrong;
    uint256 private _wronglyPaid;
    uint256 private _deposited;
    uint256 private _random;

    function setUp() public override {
        super.setUp();
        _people = [alice, robot1, judges[0], stranger];
        for (uint256 i = 0; i < 4; ++i) {
            // Enough for all cases of a run.
            deal(address(coin), _people[i], 1e30);
        }
        deal(address(coin), address(organization), 1e30);
        setInstances(threeWithStakes());
        offer(robot1, 1 gwei);
        bytes4[] memory actions = new bytes4[](1);
        actions[0] = this.dispute.selector;
        targetSelector(FuzzSelector(address(this), actions));
        targetContract(address(this));
    }

    /// forge-config: default.invariant.runs = 16
    /// @notice What stands when its time is over is done, only those who may object do, and stakes go to who is right. Judges
    /// lose theirs for what is overturned, and for nothing else.
    function invariant_whoIsRightAtTheEndLosesNothing() public view {
        assertEq(_wrong, 0, "out of turn");
        assertEq(_wronglyPaid, 0, "paid");
        assertEq(coin.balanceOf(address(disputes)), _deposited, "the stakes of cases are kept");
        uint256 staked = 0;
        for (uint8 seat = 0; seat < 4; ++seat) {
            staked += _stakeOf(committee, seat) + _stakeOf(second, seat);
        }
        assertEq(staked, _deposited, "deposits");
    }

    function dispute(uint256 seed) external {
        _random = seed;
        if (_next(4) == 0) _takeWhatHasLeft();
        _deposit();
        Course memory c;
        vm.prank(alice);
        c.taskId = tasks.registerTask(
            TaskRequest(CLEANING, 1 gwei, WINDOW, VERDICT_WINDOW, 1, 0, 0, address(0), "{}")
        );
        submit(c.taskId);
        if (_next(4) == 0) {
            _leave(uint8(_next(3)));
            if (_rule(0, _any(c.taskId))) ++_wrong;
            _deposit();
        }
        uint256[4] memory before = _balances();
        c.said[0] = _any(c.taskId);
        if (!_rule(0, c.said[0])) ++_wrong;
        c.rulings = 1;
        while (c.rulings < 3 && !c.silent) {
            _tryWhatIsNotTime(c);
            if (!_challenge(c)) break;
            _takeOver(c);
            _decide(c);
        }
        _end(c);
        _count(c, before);
    }

    /// @dev Somebody objects, in time or too late. Returns whether the next instance has to decide.
    function _challenge(Course memory c) private returns (bool) {
        bool late = _next(4) == 0;
        skip(late ? CHALLENGE + 1 : _next(CHALLENGE / 2));
        address who = _people[_next(4)];
        bool may = who != stranger && !late;
        if (_challenges(who, c.taskId) != may) ++_wrong;
        if (may) c.challengers[c.rulings - 1] = who;
        return may;
    }

    /// @dev Somebody wants to stand in another's place: a party may, in a judge's, while the window lasts.
    function _takeOver(Course memory c) private {
        bool late = _next(4) == 0;
        skip(late ? CHALLENGE + 1 : _next(CHALLENGE / 2));
        address who = _people[_next(4)];
        bool party = who == alice || who == robot1;
        bool may = party && c.challengers[c.rulings - 1] == judges[0] && !late;
        if (_challenges(who, c.taskId) != may) ++_wrong;
        if (may) c.challengers[c.rulings - 1] = who;
    }

    /// @dev The next instance answers, or lets its time pass.
    function _decide(Course memory c) private {
        if (_rule(c.rulings - 1, c.said[c.rulings - 1])) ++_wrong; // those who are challenged
        (,, uint256 until) = disputes.caseOf(c.taskId, 1);
        c.silent = _next(4) == 0;
        vm.warp(c.silent ? until + 1 : block.timestamp + _next(until - block.timestamp));
        Finding memory next = _any(c.taskId);
        if (_rule(c.rulings, next) == c.silent) ++_wrong;
        if (!c.silent) c.said[c.rulings++] = next;
    }

    /// @dev A stranger does what stands, and has the stakes paid, in any order, as late as it likes.
    function _end(Course memory c) private {
        bool final_ = c.rulings == 3;
        if (!final_ && !c.silent) skip(CHALLENGE + 1);
        if ((tasks.task(c.taskId).state == TaskState.Ruled) == final_) ++_wrong;
        if (_next(4) == 0) skip(_next(30 days));
        bool settlesFirst = _next(2) == 0;
        if (settlesFirst) disputes.settle(c.taskId, 1);
        if (!final_) {
            vm.prank(stranger);
            tasks.conclude(c.taskId);
        }
        if (!settlesFirst) disputes.settle(c.taskId, 1);
        try disputes.settle(c.taskId, 1) {
            ++_wrong;
        } catch {}
        // Given up: the attempt does not count.
        if (tasks.task(c.taskId).state == TaskState.Open) {
            vm.prank(alice);
            tasks.cancelTask(c.taskId);
        }
        if (tasks.task(c.taskId).reward != 1 gwei || coin.balanceOf(address(tasks)) != 0) ++_wronglyPaid;
    }

    /// @dev All that judges need is there.
    function _deposit() private {
        for (uint8 seat = 0; seat < 4; ++seat) {
            if (seat < 3) _fill(committee, seat);
            _fill(second, seat);
        }
    }

    function _fill(CommitteeJudge who, uint8 seat) private {
        (uint256 stake,,,) = disputes.stakeOf(who, seat);
        if (stake >= JUDGE_STAKE) return;
        deposit(who, seat, JUDGE_STAKE - stake);
        _deposited += JUDGE_STAKE - stake;
    }

    function _stakeOf(CommitteeJudge who, uint8 seat) private view returns (uint256) {
        (uint256 stake,, uint256 leaving,) = disputes.stakeOf(who, seat);
        return stake + leaving;
    }

    /// @dev What counted for this judge of the first instance does not any more, and nobody takes it so soon.
    function _leave(uint8 seat) private {
        (uint256 stake,,,) = disputes.stakeOf(committee, seat);
        vm.prank(judges[seat]);
        disputes.announceWithdrawal(committee, seat, stake);
        skip(_next(2));
        try disputes.withdrawStake(committee, seat) {
            ++_wrong;
        } catch {}
    }

    function _takeWhatHasLeft() private {
        skip(30 days + 1);
        for (uint8 seat = 0; seat < 3; ++seat) {
            (,, uint256 leaving,) = disputes.stakeOf(committee, seat);
            uint256 before = coin.balanceOf(judges[seat]);
            if (leaving != 0) disputes.withdrawStake(committee, seat);
            if (coin.balanceOf(judges[seat]) != before + leaving) ++_wronglyPaid;
            _deposited -= leaving;
        }
    }

    /// @dev What anybody may try while a ruling stands unchallenged, in its window.
    function _tryWhatIsNotTime(Course memory c) private {
        try tasks.conclude(c.taskId) {
            ++_wrong;
        } catch {}
        try disputes.settle(c.taskId, 1) {
            ++_wrong;
        } catch {}
        Finding memory standing = c.said[c.rulings - 1];
        if (_rule(c.rulings, standing)) ++_wrong;
        if (_rule(0, standing)) ++_wrong;
        // A judge that votes for what stands has staked for it, and takes nothing of that back.
        if (c.rulings != 1 || _earned(standing) == 0) return;
        vm.prank(judges[0]);
        try disputes.announceWithdrawal(committee, 0, JUDGE_STAKE) {
            ++_wrong;
        } catch {}
    }

    /// @dev The rule in other words than the contract's.
    function _count(Course memory c, uint256[4] memory before) private {
        uint256[4] memory due = before;
        Finding memory end = c.said[c.rulings - 1];
        due[0] -= _earned(end);
        due[1] += _earned(end);
        for (uint256 i = 0; i < 2 && i < c.rulings; ++i) {
            bool overturned = c.said[i].ruling != end.ruling;
            uint256 lost = overturned ? JUDGE_STAKE * (i == 0 ? 3 : 4) : 0;
            due[3] += lost;
            _deposited -= lost;
            address who = c.challengers[i];
            // Who was to decide and did not is no challenger's fault.
            if (who == address(0) || (c.silent && i == c.rulings - 1)) continue;
            uint256 stake = i == 0 ? STAKE : APPEAL;
            (uint256 then, uint256 now_) = (_goodFor(c.said[i]), _goodFor(end));
            bool right = who == alice ? now_ < then : who == robot1 ? now_ > then : overturned;
            if (right) continue;
            due[_place(who)] -= stake;
            due[who == alice || (who != robot1 && _earned(c.said[i]) != 0) ? 1 : 0] += stake;
        }
        uint256[4] memory balances = _balances();
        for (uint256 i = 0; i < 4; ++i) {
            if (balances[i] != due[i]) ++_wronglyPaid;
        }
    }

    /// @dev By the executor.
    function _earned(Finding memory f) private pure returns (uint256) {
        if (f.ruling == Ruling.Accepted) return 1 gwei;
        return f.ruling == Ruling.Impossible ? 0.1 gwei : 0;
    }

    /// @dev For the executor: a rejection is worst, and to have given up worse than that nobody did.
    function _goodFor(Finding memory f) private pure returns (uint256) {
        if (f.ruling == Ruling.Rejected) return 0;
        return f.ruling == Ruling.GivenUp ? 1 : 2 + _earned(f);
    }

    /// @dev What the task held when it was posted is in escrow still, and counts as alice's.
    function _balances() private view returns (uint256[4] memory) {
        return [
            coin.balanceOf(alice) + coin.balanceOf(address(tasks)),
            coin.balanceOf(robot1),
            coin.balanceOf(judges[0]),
            coin.balanceOf(address(organization))
        ];
    }

    function _place(address who) private view returns (uint256) {
        return who == alice ? 0 : who == robot1 ? 1 : 2;
    }

    function _any(TaskId taskId) private returns (Finding memory) {
        return voteOf(taskId, Ruling(1 + _next(5)));
    }

    function _challenges(address who, TaskId taskId) private returns (bool) {
        (InstanceRuling[] memory rulings,,) = disputes.caseOf(taskId, 1);
        uint8 last = rulings.length == 0 ? 0 : uint8(rulings.length - 1);
        vm.prank(who);
        try disputes.challenge(taskId, 1, last, "wrong") {
            return true;
        } catch {
            return false;
        }
    }

    /// @dev Whether the votes of this instance were a ruling.
    function _rule(uint256 instance, Finding memory vote) private returns (bool) {
        if (instance == 3) return false;
        bytes memory votes = instance == 0
            ? signatures(vote, 3)
            : instance == 1 ? by(second, secondKeys, 4, vote) : by(third, thirdKeys, 5, vote);
        try disputes.postVotes(vote, REPORT_URI, votes) {
            return true;
        } catch {
            return false;
        }
    }

    function _next(uint256 below) private returns (uint256) {
        _random = uint256(keccak256(abi.encode(_random)));
        return _random % below;
    }
}
