// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Service} from "../src/interfaces/IServiceManager.sol";
import {Cause, Ruling, Task, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice The table of docs/reference/contracts.md: what each end of an attempt does. Each row is computed here, for a ruling
/// that is final at once and for one that stood before; tests/docs compares the rows with the page.
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
        _rules(Ruling.GivenUp, "| GivenUp | again | nothing | nothing | yes | none | whole | none |");
        _rules(Ruling.Void, "| Void | failed | nothing | the reward | the task ends | none | whole | none |");
    }

    function test_attemptsWithoutAProof() public {
        _ends(
            Cause.ExecutionExpired,
            "| ExecutionExpired | again | nothing | nothing | yes | to the treasury | less the penalty | expired |"
        );
        _ends(Cause.NotAccepted, "| NotAccepted | again | nothing | nothing | yes | none | whole | none |");
        _ends(Cause.Abandoned, "| Abandoned | again | nothing | nothing | yes | none | whole | none |");
        _ends(
            Cause.AbandonedLate,
            "| AbandonedLate | again | nothing | nothing | yes | to the treasury | less the penalty | expired |"
        );
    }

    function test_whatIsAgainFailsAtTheLastAttempt() public {
        Ruling[2] memory again = [Ruling.Rejected, Ruling.GivenUp];
        for (uint256 i = 0; i < 2; ++i) {
            _begin(1);
            submit(_task);
            judgeAs(oracle, _task, again[i], 0);
            assertState(_task, TaskState.Failed);
            assertEq(coin.balanceOf(alice) - _balances[1], REWARD);
        }
    }

    /// @dev Final at once; standing, and concluded by a stranger; standing as something else, and replaced.
    function _rules(Ruling ruling, string memory row) private {
        uint256 amount = ruling == Ruling.Accepted ? AMOUNT : 0;
        for (uint256 way = 0; way < 3; ++way) {
            _begin(2);
            submit(_task);
            uint256 end = tasks.attemptOf(_task).caseEnd;
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
            assertEq(_row(names[uint8(ruling) - 1]), row);
        }
    }

    function _ends(Cause cause, string memory row) private {
        _begin(2);
        Task memory t = tasks.task(_task);
        bool accepts = cause == Cause.ExecutionExpired || cause == Cause.AbandonedLate;
        if (accepts) {
            vm.prank(robot1);
            tasks.acceptTask(_task, 1);
        }
        if (cause == Cause.Abandoned || cause == Cause.AbandonedLate) {
            if (cause == Cause.AbandonedLate) vm.warp(t.deadline);
            vm.prank(robot1);
            tasks.abandonTask(_task, 1);
        } else {
            vm.warp(uint256(t.deadline) + 1);
            tasks.expireTask(_task);
        }
        string[4] memory names = ["ExecutionExpired", "NotAccepted", "Abandoned", "AbandonedLate"];
        assertEq(_row(names[uint8(cause) - uint8(Cause.ExecutionExpired)]), row);
    }

    /// @dev A task of alice's that robot1 does with a service that has agreed to terms.
    function _begin(uint8 attempts) private {
        setUp();
        setTerms(BOND, PENALTY, 0);
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
    function _row(string memory name) private view returns (string memory) {
        Service memory s = services.service(_service);
        uint256 paid = coin.balanceOf(robot1) - _balances[0];
        uint256 back = coin.balanceOf(alice) - _balances[1];
        uint256 penalty = coin.balanceOf(address(organization)) - _balances[2];
        assertEq(s.bond, BOND - penalty, "the bond");
        assertEq(s.failures, penalty == 0 ? 0 : 1, "failures");
        bool live = state(_task) != TaskState.Settled && state(_task) != TaskState.Failed;
        assertEq(tasks.held(), s.bond + (live ? REWARD : 0), "the escrow");
        string memory record = s.completed != _before.completed
            ? "completed"
            : s.rejected != _before.rejected ? "rejected" : s.expired != _before.expired ? "expired" : "none";
        return string.concat(
            "| ",
            name,
            " | ",
            _end(),
            " | ",
            _paid(paid),
            " | ",
            _back(back, paid),
            live ? " | yes | " : " | the task ends | ",
            _penalty(penalty),
            s.bond == BOND ? " | whole | " : " | less the penalty | ",
            record,
            " |"
        );
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
