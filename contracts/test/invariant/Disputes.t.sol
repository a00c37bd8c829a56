// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Vote} from "../../src/interfaces/IOracleCommittee.sol";
import {TaskRequest, TaskState, Verdict} from "../../src/interfaces/ITaskManager.sol";
import {TaskId} from "../../src/types/TaskId.sol";
import {Instances} from "../Instances.sol";

/// @notice Whole cases, in which everybody acts at any time and in any way.
contract DisputesInvariants is Instances {
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
    /// @notice Verdicts stand when their time is over, only those who may object do, and stakes go to who is right. Judges
    /// lose theirs for what is overturned, and for nothing else.
    function invariant_whoIsRightAtTheEndLosesNothing() public view {
        assertEq(_wrong, 0, "out of turn");
        assertEq(_wronglyPaid, 0, "paid");
        assertEq(coin.balanceOf(address(disputes)), _deposited, "kept");
        assertEq(deposited(), _deposited, "deposits");
    }

    function dispute(uint256 seed) external {
        _random = seed;
        if (_next(4) == 0) _takeWhatHasLeft();
        _deposit();
        TaskRequest memory wanted =
            TaskRequest(CLEANING, 1 gwei, WINDOW, 2 hours + 1, 1, 0, 0, address(0), "{}");
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(wanted);
        submit(taskId);
        if (_next(4) == 0) {
            _leave(uint8(_next(3)));
            if (_rule(0, _any(taskId))) ++_wrong;
            _deposit();
        }
        uint256 paid = coin.balanceOf(address(tasks));
        uint256[4] memory before = _balances();
        Vote memory standing = _any(taskId);
        if (!_rule(0, standing)) ++_wrong;
        if (_next(4) == 0) _leave(uint8(_next(3)));
        address[2] memory challengers;
        Vote[3] memory said;
        uint256 rulings = 1;
        said[0] = standing;
        bool open = true;
        while (open) {
            _tryWhatIsNotTime(standing, rulings);
            bool late = _next(4) == 0;
            skip(late ? CHALLENGE + 1 : _next(CHALLENGE));
            address who = _people[_next(4)];
            bool may = who != stranger && !late;
            vm.prank(who);
            try disputes.challenge(taskId, "wrong") {
                if (!may) ++_wrong;
                challengers[rulings - 1] = who;
            } catch {
                if (may) ++_wrong;
            }
            if (challengers[rulings - 1] == address(0)) {
                skip(CHALLENGE + 1);
                break;
            }
            if (_rule(rulings - 1, standing)) ++_wrong; // those who are challenged
            late = _next(4) == 0;
            skip(late ? DECISION + 1 : _next(DECISION));
            Vote memory next = _any(taskId);
            if (_rule(rulings, next) == late) ++_wrong;
            if (late) {
                challengers[rulings - 1] = address(0); // has its stake back
                break;
            }
            said[rulings++] = standing = next;
            open = rulings != 3;
        }
        if (rulings != 3) _close(standing);
        if (tasks.task(taskId).state == TaskState.Submitted) ++_wrong;
        if (coin.balanceOf(address(tasks)) != paid - 1 gwei) ++_wronglyPaid;
        _count(before, challengers, said, rulings, standing);
    }

    /// @dev All that judges need is there.
    function _deposit() private {
        for (uint8 seat = 0; seat < 4; ++seat) {
            if (seat < 3) _deposited += deposit(committee, seat);
            _deposited += deposit(second, seat);
        }
    }

    /// @dev What counted for this judge of the first instance does not any more, and nobody takes it so soon.
    function _leave(uint8 seat) private {
        (uint256 stake,,) = disputes.stakeOf(committee, seat);
        vm.prank(judges[seat]);
        disputes.announceWithdrawal(committee, seat, stake);
        skip(_next(2));
        try disputes.withdrawStake(committee, seat) {
            ++_wrong;
        } catch {}
    }

    function _takeWhatHasLeft() private {
        skip(disputes.UNBONDING() + 1);
        for (uint8 seat = 0; seat < 3; ++seat) {
            (, uint256 leaving,) = disputes.stakeOf(committee, seat);
            uint256 before = coin.balanceOf(judges[seat]);
            if (leaving != 0) disputes.withdrawStake(committee, seat);
            if (coin.balanceOf(judges[seat]) != before + leaving) ++_wronglyPaid;
            _deposited -= leaving;
        }
    }

    /// @dev What anybody may try while a verdict stands unchallenged, in its window.
    function _tryWhatIsNotTime(Vote memory standing, uint256 rulings) private {
        try disputes.close(standing, REPORT_URI) {
            ++_wrong;
        } catch {}
        if (_rule(rulings, standing)) ++_wrong;
        if (_rule(0, standing)) ++_wrong;
    }

    function _close(Vote memory standing) private {
        Vote memory other = standing;
        other.reason = "another";
        try disputes.close(other, REPORT_URI) {
            ++_wrong;
        } catch {}
        other.reason = "accepted";
        disputes.close(standing, REPORT_URI);
    }

    /// @dev The rule in other words than the contract's.
    function _count(
        uint256[4] memory before,
        address[2] memory challengers,
        Vote[3] memory said,
        uint256 rulings,
        Vote memory standing
    ) private {
        uint256[4] memory due = before;
        uint256 earned = _earned(standing);
        due[0] += 1 gwei - earned;
        due[1] += earned;
        bool[2] memory right;
        for (uint256 i = 0; i < 2 && i < rulings; ++i) {
            bool overturned = said[i].verdict != standing.verdict;
            right[i] = overturned;
            if (challengers[i] == alice) right[i] = earned < _earned(said[i]);
            if (challengers[i] == robot1) right[i] = earned > _earned(said[i]);
            uint256 lost = overturned ? JUDGE_STAKE * (i == 0 ? 3 : 4) : 0;
            due[3] += lost;
            _deposited -= lost;
        }
        for (uint256 i = 0; i < 2; ++i) {
            if (challengers[i] == address(0) || right[i]) continue;
            uint256 stake = i == 0 ? STAKE : APPEAL;
            due[_place(challengers[i])] -= stake;
            address other = challengers[1 - i];
            if (other != address(0) && right[1 - i]) due[_place(other)] += stake;
            else due[challengers[i] == alice ? 1 : challengers[i] == robot1 ? 0 : 3] += stake;
        }
        uint256[4] memory now_ = _balances();
        for (uint256 i = 0; i < 4; ++i) {
            if (now_[i] != due[i]) ++_wronglyPaid;
        }
    }

    /// @dev By the executor.
    function _earned(Vote memory vote) private pure returns (uint256) {
        if (vote.verdict == Verdict.Accepted) return 1 gwei;
        return vote.verdict == Verdict.Impossible ? 0.1 gwei : 0;
    }

    function _balances() private view returns (uint256[4] memory) {
        return [
            coin.balanceOf(alice),
            coin.balanceOf(robot1),
            coin.balanceOf(judges[0]),
            coin.balanceOf(address(organization))
        ];
    }

    function _place(address who) private view returns (uint256) {
        return who == alice ? 0 : who == robot1 ? 1 : 2;
    }

    function _any(TaskId taskId) private returns (Vote memory) {
        Verdict[3] memory verdicts = [Verdict.Accepted, Verdict.Rejected, Verdict.Impossible];
        return voteOf(taskId, verdicts[_next(3)]);
    }

    /// @dev Whether the votes of this instance were a ruling.
    function _rule(uint256 instance, Vote memory vote) private returns (bool) {
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
