// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {ICommitteeJudge} from "../src/interfaces/ICommitteeJudge.sol";
import {Finding} from "../src/interfaces/IJudge.sol";
import {Ruling, TaskState} from "../src/interfaces/ITaskManager.sol";
import {KindId} from "../src/types/KindId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Instances} from "./Instances.sol";

/// @notice The second table of docs/reference/contracts.md: how a case ends where judges say nothing. Each row is computed here;
/// tests/docs compares the rows with the page.
contract SilenceTest is Instances {
    TaskId private _task;
    uint256 private _robots;
    uint256 private _creators;

    function test_nobodyRules() public {
        _begin();
        assertEq(_row("nobody rules"), "| nobody rules | Void |");
    }

    function test_tooFewVotesAreEqual() public {
        _begin();
        Ruling[2] memory said = [Ruling.Accepted, Ruling.Rejected];
        for (uint256 i = 0; i < 2; ++i) {
            Finding memory vote = voteOf(_task, said[i]);
            bytes memory votes =
                abi.encodePacked(sign(judgeKeys[2 * i], vote), sign(judgeKeys[2 * i + 1], vote));
            vm.expectPartialRevert(ICommitteeJudge.TooFewVotes.selector);
            disputes.postVotes(vote, REPORT_URI, votes);
        }
        assertEq(_row("too few votes are equal"), "| too few votes are equal | Void |");
    }

    function test_theJudgePassesOn() public {
        _begin();
        first(_task, Ruling.None);
        assertEq(
            _row("the judge passes the case on, and nobody else rules"),
            "| the judge passes the case on, and nobody else rules | Void |"
        );
    }

    function test_theJudgeIsRemoved() public {
        Ruling[3] memory said = [Ruling.Accepted, Ruling.Impossible, Ruling.Rejected];
        for (uint256 i = 0; i < 3; ++i) {
            if (i > 0) setUp();
            _begin();
            first(_task, said[i]);
            KindId number = organization.numberOf(CLEANING);
            vm.prank(admin);
            organization.removeJudge(number);
            assertEq(
                _row("the judge is removed, and nobody else rules"),
                "| the judge is removed, and nobody else rules | Void |"
            );
        }
    }

    function test_nobodyAnswersAChallenge() public {
        Ruling[4] memory said = [Ruling.Accepted, Ruling.Impossible, Ruling.Rejected, Ruling.GivenUp];
        string[4] memory names = ["Accepted", "Impossible", "Rejected", "GivenUp"];
        for (uint256 i = 0; i < 4; ++i) {
            if (i > 0) setUp();
            _begin();
            first(_task, said[i]);
            challenge(i < 2 ? alice : robot1, _task);
            (_robots, _creators) = (coin.balanceOf(robot1), coin.balanceOf(alice));
            _conclude();
            string memory end =
                keccak256(bytes(_ended())) == keccak256(bytes(names[i])) ? "as it was ruled" : "?";
            assertEq(
                string.concat("| nobody answers a challenge | ", end, " |"),
                "| nobody answers a challenge | as it was ruled |"
            );
        }
    }

    function _begin() private {
        _task = waiting();
        (_robots, _creators) = (coin.balanceOf(robot1), coin.balanceOf(alice));
    }

    function _row(string memory what) private returns (string memory) {
        _conclude();
        return string.concat("| ", what, " | ", _ended(), " |");
    }

    /// @dev A stranger concludes the case as soon as that may be.
    function _conclude() private {
        if (state(_task) == TaskState.Submitted) {
            vm.warp(tasks.task(_task).deadline + 1);
            vm.prank(stranger);
            tasks.conclude(_task);
        }
        while (state(_task) == TaskState.Ruled) {
            vm.warp(tasks.standing(_task).until + 1);
            vm.prank(stranger);
            tasks.conclude(_task);
        }
    }

    function _ended() private view returns (string memory) {
        uint256 paid = coin.balanceOf(robot1) - _robots;
        uint256 back = coin.balanceOf(alice) - _creators;
        if (state(_task) == TaskState.Failed) return paid == 0 && back == 100 ether ? "Void" : "?";
        if (state(_task) == TaskState.Settled) {
            if (back != 100 ether - paid) return "?";
            return paid == 80 ether ? "Accepted" : paid == 8 ether ? "Impossible" : "?";
        }
        if (paid + back > 0) return "?";
        return services.service(serviceNo(1)).rejected > 0 ? "Rejected" : "GivenUp";
    }
}
