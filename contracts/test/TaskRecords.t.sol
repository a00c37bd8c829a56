// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {SafeCast} from "@openzeppelin/contracts/utils/math/SafeCast.sol";
import {IOrganization, Review} from "../src/interfaces/IOrganization.sol";
import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {Hire, Silence, Task, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {Conditions, TaskRecords} from "../src/libraries/TaskRecords.sol";
import {FirstComeFirstServed} from "../src/policies/FirstComeFirstServed.sol";
import {LowestPrice} from "../src/policies/LowestPrice.sol";
import {Fixture} from "./Fixture.sol";

/// @notice Tasks in one word, and kinds as small numbers.
contract TaskRecordsTest is Fixture {
    using TaskRecords for mapping(uint32 => Conditions);

    mapping(uint32 key => Conditions) private _conditions;

    function testFuzz_conditionsAreWhatTheyWere(
        address creator,
        uint24 executionWindow,
        uint24 verdictWindow,
        uint8 kindId,
        uint8 maxAttempts,
        bool named
    ) public pure {
        Conditions c = TaskRecords.pack(
            creator,
            executionWindow,
            verdictWindow,
            kindId,
            maxAttempts,
            Silence.Creator,
            named ? Hire.Service : Hire.Provider
        );
        assertEq(c.creator(), creator);
        assertEq(c.executionWindow(), executionWindow);
        assertEq(c.verdictWindow(), verdictWindow);
        assertEq(c.kindId(), kindId);
        assertEq(c.maxAttempts(), maxAttempts);
        assertEq(uint8(c.silence()), uint8(Silence.Creator));
        assertEq(uint8(c.hired()), uint8(named ? Hire.Service : Hire.Provider));
    }

    function test_whoFindsAPlaceTakenTakesTheNext() public {
        Conditions one = TaskRecords.pack(alice, 1, 2, 3, 4, Silence.None, Hire.None);
        Conditions other = TaskRecords.pack(bob, 1, 2, 3, 4, Silence.None, Hire.None);
        uint32 key = _conditions.keep(one);
        assertEq(_conditions.keep(one), key, "shared");
        _conditions[key] = other;
        assertEq(_conditions.keep(one), key + 1, "the next");
        assertEq(_conditions.keep(one), key + 1, "shared");
        assertEq(Conditions.unwrap(_conditions[key]), Conditions.unwrap(other), "untouched");
    }

    function test_tasksOfDifferentConditionsAreApart() public {
        uint256 first = post(alice, 100 ether);
        uint256 second = post(bob, 90 ether);
        TaskRequest memory r = request(80 ether);
        (r.executionWindow, r.maxAttempts) = (2 hours, 1);
        vm.prank(alice);
        uint256 third = tasks.registerTask(r);
        assertEq(tasks.task(first).creator, alice);
        assertEq(tasks.task(second).creator, bob);
        assertEq(tasks.task(first).maxAttempts, ATTEMPTS);
        Task memory t = tasks.task(third);
        assertEq(t.creator, alice);
        assertEq(t.reward, 80 ether);
        assertEq(t.executionWindow, 2 hours);
        assertEq(t.maxAttempts, 1);
        assertEq(uint8(t.state), uint8(TaskState.Open));
    }

    function test_aRewardIsAtMostWhatItsBitsHold() public {
        TaskRequest memory r = request(1 << 88);
        vm.prank(alice);
        vm.expectRevert(
            abi.encodeWithSelector(SafeCast.SafeCastOverflowedUintDowncast.selector, 88, uint256(1 << 88))
        );
        tasks.registerTask(r);
    }

    function test_nobodyHasToAskWhoeverChoosesTheLongestIdle() public {
        assertEq(address(_matching()), address(0));
        IMatchingPolicy cheapest = new LowestPrice();
        vm.prank(admin);
        organization.setPolicy(cheapest);
        assertEq(address(_matching()), address(cheapest));
        IMatchingPolicy first = new FirstComeFirstServed();
        vm.prank(admin);
        organization.setPolicy(first);
        assertEq(address(_matching()), address(0));
        assertEq(address(organization.policy()), address(first));
    }

    function test_kindsAreNumbered() public {
        assertEq(organization.numberOf(CLEANING), 1);
        assertEq(organization.kindNumbered(2), CHARGING);
        assertEq(organization.numberOf("painting"), 0);
        assertEq(organization.kindNumbered(3), 0);
        assertEq(organization.kindOf(CHARGING).number, 2);
        vm.startPrank(admin);
        for (uint256 i = 3; i <= 255; ++i) {
            organization.allowKind(bytes32(i), Review.Auditor, 0);
        }
        organization.allowKind(CLEANING, Review.Oracle, RULES);
        assertEq(organization.numberOf(CLEANING), 1, "kept");
        vm.expectRevert(abi.encodeWithSelector(IOrganization.TooManyKinds.selector, bytes32("one more"), 255));
        organization.allowKind("one more", Review.Auditor, 0);
    }

    function _matching() private view returns (IMatchingPolicy matching) {
        (matching,,,) = organization.admitTask(CLEANING, alice, WINDOW, WINDOW, 0);
    }
}
