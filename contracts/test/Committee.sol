// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Finding} from "../src/interfaces/IJudge.sol";
import {Fault, Ruling, Task} from "../src/interfaces/ITaskManager.sol";
import {CommitteeJudge} from "../src/judges/CommitteeJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";

/// @notice The organization with a committee of five in place of its one oracle: three votes of all five.
abstract contract Committee is Fixture {
    uint8 internal constant JUDGES = 5;
    uint8 internal constant VOTES = 3;
    uint64 internal constant ALL = 31;

    CommitteeJudge internal committee;
    uint256[JUDGES] internal judgeKeys;
    address[JUDGES] internal judges;

    function setUp() public virtual override {
        super.setUp();
        committee = committeeJudge(address(auditorJudge));
        for (uint8 i = 0; i < JUDGES; ++i) {
            (judges[i], judgeKeys[i]) = makeAddrAndKey(string.concat("judge", vm.toString(i)));
            seat(judges[i], judgeKeys[i], judges[i]);
        }
        setQuorum(VOTES, JUDGES, 0, ALL);
        vm.prank(admin);
        organization.allowKind(CLEANING, committee, RULES);
    }

    function setQuorum(uint8 votes, uint8 panel, uint32 rotation, uint64 seats) internal {
        vm.prank(admin);
        committee.setQuorum(CLEANING, votes, panel, rotation, seats);
    }

    /// @dev It counts from the next second on.
    function seat(address key, uint256 secret, address owner) internal returns (uint8 number) {
        return seatIn(committee, key, secret, owner);
    }

    /// @dev Of those whose keys Possession knows.
    function seat(address key, address owner) internal returns (uint8 number) {
        return seatIn(committee, key, Possession.keyOf(key), owner);
    }

    function seatIn(CommitteeJudge who, address key, uint256 secret, address owner)
        internal
        returns (uint8 number)
    {
        (bytes32 r, bytes32 vs) = vm.signCompact(secret, who.possessionOf(key, owner));
        vm.prank(admin);
        number = who.seat(key, owner, r, vs);
        skip(1);
    }

    /// @dev As `who`; the new key counts from the next second on.
    function changeKey(address who, address old, address key, uint256 secret) internal {
        (bytes32 r, bytes32 vs) =
            vm.signCompact(secret, committee.possessionOf(key, committee.seatOf(old).owner));
        vm.prank(who);
        committee.changeKey(old, key, r, vs);
        skip(1);
    }

    /// @dev A task of alice's whose proof robot1 has submitted.
    function submitted() internal returns (TaskId taskId) {
        offer(robot1, 80 ether);
        taskId = post(alice, 100 ether);
        submit(taskId);
    }

    function accepting(TaskId taskId) internal view returns (Finding memory) {
        Task memory t = tasks.task(taskId);
        return
            Finding(
                taskId, t.attempt, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, t.price, "accepted"
            );
    }

    function sign(uint256 key, Finding memory vote) internal view returns (bytes memory) {
        (bytes32 r, bytes32 vs) = vm.signCompact(key, committee.digestOf(vote));
        return abi.encodePacked(r, vs);
    }

    /// @dev The first `count` judges sign it.
    function signatures(Finding memory vote, uint256 count) internal view returns (bytes memory all) {
        for (uint256 i = 0; i < count; ++i) {
            all = abi.encodePacked(all, sign(judgeKeys[i], vote));
        }
    }
}
