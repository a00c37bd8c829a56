// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {OracleCommittee} from "../src/OracleCommittee.sol";
import {Vote} from "../src/interfaces/IOracleCommittee.sol";
import {Task, Verdict} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice The organization with a committee of five in place of its one oracle: three votes of all five.
abstract contract Committee is Fixture {
    uint8 internal constant JUDGES = 5;
    uint8 internal constant VOTES = 3;
    uint64 internal constant ALL = 31;

    OracleCommittee internal committee;
    uint256[JUDGES] internal judgeKeys;
    address[JUDGES] internal judges;

    function setUp() public virtual override {
        super.setUp();
        committee = new OracleCommittee(organization);
        bytes32 role = organization.ORACLE_ROLE();
        vm.startPrank(admin);
        organization.revokeRole(role, oracle);
        organization.grantRole(role, address(committee));
        for (uint8 i = 0; i < JUDGES; ++i) {
            (judges[i], judgeKeys[i]) = makeAddrAndKey(string.concat("judge", vm.toString(i)));
            committee.seat(judges[i], judges[i]);
        }
        committee.setQuorum(CLEANING, VOTES, JUDGES, 0, ALL);
        vm.stopPrank();
    }

    function setQuorum(uint8 votes, uint8 panel, uint32 rotation, uint64 judges_) internal {
        vm.prank(admin);
        committee.setQuorum(CLEANING, votes, panel, rotation, judges_);
    }

    /// @dev A task of alice's whose proof robot1 has submitted.
    function submitted() internal returns (TaskId taskId) {
        offer(robot1, 80 ether);
        taskId = post(alice, 100 ether);
        submit(taskId);
    }

    function accepting(TaskId taskId) internal view returns (Vote memory) {
        Task memory t = tasks.task(taskId);
        return Vote(taskId, t.attempt, PROOF, REPORT, RULES, Verdict.Accepted, t.price, "accepted");
    }

    function sign(uint256 key, Vote memory vote) internal view returns (bytes memory) {
        (bytes32 r, bytes32 vs) = vm.signCompact(key, committee.digestOf(vote));
        return abi.encodePacked(r, vs);
    }

    /// @dev The first `count` judges sign it.
    function signatures(Vote memory vote, uint256 count) internal view returns (bytes memory all) {
        for (uint256 i = 0; i < count; ++i) {
            all = abi.encodePacked(all, sign(judgeKeys[i], vote));
        }
    }
}
