// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Service} from "../src/interfaces/IServiceManager.sol";
import {Cause, Ruling, Task, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice The table of docs/reference/contracts.md: what each end of an attempt does. Each row is computed here, for a ruling
/// that is final at once and for one that stood before, and for a provider that is proven and one that is not; tests/docs
/// compares the rows with the page.
contract EndsTest is Fixture {
    uint96 private constant BOND = 20 ether;
    uint96 private constant PENALTY = 5 ether;
    uint96 private constant AMOUNT = 50 ether;
    uint256 private constant PRICE = 80 ether;
    uint256 private constant REWARD = 100 ether;

    TaskId private _task;
    ServiceId private _service;
    Service private _before;
    uint256[3] private _balances;

    function test_rulings() public {
        _rules(
            Ruling.Accepted,
            "| Accepted | settled | the amount | the rest | the task ends | none | whole | completed |"
        );
        _rules(
            Ruling.Impossible,
            "| Impossible | settled | a tenth of the price | the rest | the task ends | none | whole | none |"
        );
        _rules(
            Ruling.Rejected,
            "| Rejected | again | nothing | nothing | yes | to the treasury | less the penalty | rejected |"
        );
        _rules(
            Ruling.GivenUp,
            "| GivenUp | again | nothing | nothing | no; yes if not proven | none; to the treasury if not proven | whole; less the penalty if not proven | none |"
        );
        _rules(Ruling.Void, "| Void | failed | nothing | the reward | the task ends | none | whole | none |");
    }

    function test_attemptsWithoutAProof() public {
        _ends(
            Cause.ExecutionExpired,
            "| ExecutionExpired | again | nothing | nothing | yes | to the treasury | less the penalty | expired |"
        );
        _ends(Cause.NotAccepted, "| NotAccepted | again | nothing | nothing | no | none | whole | none |");
        _ends(Cause.Abandoned, "| Abandoned | again | nothing | nothing | no | none | whole | none |");
        _ends(
            Cause.AbandonedLate,
            "| AbandonedLate | again | nothing | nothing | yes | to the treasury | less the penalty | expired |"
        );
    }

    function test_whatCountsFailsAtTheLastAttempt() public {
        for (uint256 i = 0; i < 3; ++i) {
            _begin(1, i != 1);
            submit(_task);
            judgeAs(oracle, _task, i == 0 ? Ruling.Rejected : Ruling.GivenUp, 0);
            bool counts = i < 2;
            assertState(_task, counts ? TaskState.Failed : TaskState.Open);
            assertEq(coin.balanceOf(alice) - _balances[1], counts ? REWARD : 0);
        }
    }

    /// @dev Final at once; standing, and concluded by a stranger; standing as something else, and replaced.
    function _rules(Ruling ruling, string memory row) private {
        uint256 amount = ruling == Ruling.Accepted ? AMOUNT : 0;
        for (uint256 way = 0; way < 3; ++way) {
            string[8] memory proven = _ruled(ruling, amount, way, true);
            assertEq(_row(proven, _ruled(ruling, amount, way, false)), row);
        }
    }

    function _ruled(Ruling ruling, uint256 amount, uint256 way, bool proven)
        private
        returns (string[8] memory)
    {
        _begin(2, proven);
        submit(_task);
        uint256 end = tasks.task(_task).caseEnd;
        if (way == 1) ruleUntil(oracleJudge, _task, ruling, amount, end);
        if (way == 2) ruleUntil(oracleJudge, _task, Ruling.Void, 0, end);
        if (way == 1) {
            vm.warp(end + 1);
            vm.prank(stranger);
            tasks.conclude(_task);
        } else {
            judgeAs(oracle, _task, ruling, amount);
        }
        string[5] memory names = ["Accepted", "Rejected", "GivenUp", "Impossible", "Void"];
        return _cells(names[uint8(ruling) - 1]);
    }

    function _ends(Cause cause, string memory row) private {
        string[8] memory proven = _ended(cause, true);
        assertEq(_row(proven, _ended(cause, false)), row);
    }

    function _ended(Cause cause, bool proven) private returns (string[8] memory) {
        _begin(2, proven);
        Task memory t = tasks.task(_task);
        bool accepts = cause == Cause.ExecutionExpired || cause == Cause.AbandonedLate;
        if (accepts) {
            vm.prank(robot1);
            tasks.acceptTask(_task, 1);
        }
        if (cause == Cause.Abandoned || cause == Cause.AbandonedLate) {
            // Without having accepted it, late as well.
            if (accepts || !proven) vm.warp(t.deadline);
            vm.prank(robot1);
            tasks.abandonTask(_task, 1);
        } else {
            vm.warp(uint256(t.deadline) + 1);
            tasks.expireTask(_task);
        }
        string[4] memory names = ["ExecutionExpired", "NotAccepted", "Abandoned", "AbandonedLate"];
        return _cells(names[uint8(cause) - uint8(Cause.ExecutionExpired)]);
    }

    /// @dev A task of alice's that robot1 does with a service that has agreed to terms.
    function _begin(uint8 attempts, bool proven) private {
        setUp();
        setTerms(BOND, PENALTY, 0);
        vm.prank(admin);
        organization.vouchFor(robot1, proven);
        vm.prank(robot1);
        _service = services.registerService(CLEANING, PRICE, NO_LIMIT, false, "");
        TaskRequest memory r = request(REWARD);
        r.maxAttempts = attempts;
        vm.prank(alice);
        _task = tasks.registerTask(r);
        assertAssigned(_task, _service);
        _before = services.service(_service);
        _balances = [coin.balanceOf(robot1), coin.balanceOf(alice), coin.balanceOf(address(organization))];
    }

    /// @dev What has happened since then.
    function _cells(string memory name) private view returns (string[8] memory) {
        Service memory s = services.service(_service);
        uint256 paid = coin.balanceOf(robot1) - _balances[0];
        uint256 back = coin.balanceOf(alice) - _balances[1];
        uint256 penalty = coin.balanceOf(address(organization)) - _balances[2];
        assertEq(s.bond, BOND - penalty, "the bond");
        bool failed = s.rejected != _before.rejected || s.expired != _before.expired;
        assertEq(s.failures, failed ? 1 : 0, "failures");
        bool live = state(_task) != TaskState.Settled && state(_task) != TaskState.Failed;
        assertEq(tasks.held(), s.bond + (live ? REWARD : 0), "the escrow");
        return [
            name,
            _end(),
            _paid(paid),
            _back(back, paid),
            live ? (tasks.queues().passed(_task).isEmpty() ? "yes" : "no") : "the task ends",
            _penalty(penalty),
            s.bond == BOND ? "whole" : "less the penalty",
            _recorded(s)
        ];
    }

    /// @dev A cell that is another one for who is not proven has both.
    function _row(string[8] memory proven, string[8] memory other) private pure returns (string memory row) {
        row = "|";
        for (uint256 i = 0; i < 8; ++i) {
            row = string.concat(row, " ", proven[i]);
            bool same = keccak256(bytes(proven[i])) == keccak256(bytes(other[i]));
            row = same ? string.concat(row, " |") : string.concat(row, "; ", other[i], " if not proven |");
        }
    }

    function _recorded(Service memory s) private view returns (string memory) {
        if (s.completed != _before.completed) return "completed";
        if (s.rejected != _before.rejected) return "rejected";
        return s.expired != _before.expired ? "expired" : "none";
    }

    function _end() private view returns (string memory) {
        TaskState now_ = state(_task);
        if (now_ == TaskState.Settled) return "settled";
        return now_ == TaskState.Failed ? "failed" : "again";
    }

    function _paid(uint256 amount) private pure returns (string memory) {
        if (amount == AMOUNT) return "the amount";
        return amount == PRICE / 10 ? "a tenth of the price" : amount == 0 ? "nothing" : "?";
    }

    function _back(uint256 amount, uint256 paid) private pure returns (string memory) {
        if (amount == 0) return "nothing";
        return amount == REWARD ? "the reward" : amount == REWARD - paid ? "the rest" : "?";
    }

    function _penalty(uint256 amount) private pure returns (string memory) {
        return amount == PENALTY ? "to the treasury" : amount == 0 ? "none" : "?";
    }
}
