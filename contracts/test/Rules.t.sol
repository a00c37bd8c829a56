// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IOrganization, MAX_RULES} from "../src/interfaces/IOrganization.sol";
import {ITaskManager, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {KindId} from "../src/types/KindId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";

/// @notice By which rules a task is judged, and that nobody changes them behind somebody's back.
contract RulesTest is Fixture {
    bytes32 private constant NEXT = keccak256("next rules");

    function _allow(bytes32 rules) private {
        vm.prank(admin);
        organization.allowKind(CLEANING, oracleJudge, rules);
    }

    function _retire(bytes32 rules) private {
        vm.prank(admin);
        organization.retireRules(CLEANING, rules);
    }

    /// @dev Post a task that names `wanted`, and expect it to get `got`.
    function _post(bytes32 wanted, bytes32 got) private returns (TaskId taskId) {
        TaskRequest memory r = request(100 ether);
        r.rules = wanted;
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRegistered(
            taskNo(tasks.taskCount() + 1), alice, CLEANING, 100 ether, WINDOW, WINDOW, ATTEMPTS, got, "{}"
        );
        vm.prank(alice);
        return tasks.registerTask(r);
    }

    function _refused(bytes32 wanted) private {
        TaskRequest memory r = request(100 ether);
        r.rules = wanted;
        vm.expectRevert(abi.encodeWithSelector(IOrganization.RulesNotCurrent.selector, CLEANING, wanted));
        vm.prank(alice);
        tasks.registerTask(r);
    }

    function _assertRules(bytes32[] memory expected) private view {
        assertEq(organization.currentRules(CLEANING), expected);
    }

    function _list(bytes32 one) private pure returns (bytes32[] memory list) {
        list = new bytes32[](1);
        list[0] = one;
    }

    function _list(bytes32 one, bytes32 two) private pure returns (bytes32[] memory list) {
        list = new bytes32[](2);
        (list[0], list[1]) = (one, two);
    }

    function test_severalRulesAreCurrentAndATaskGetsTheNewest() public {
        _post(0, RULES);
        vm.expectEmit(address(organization));
        emit IOrganization.KindAllowed(CLEANING, KindId.wrap(1), oracleJudge, NEXT, 1 minutes, 30 days);
        _allow(NEXT);
        _assertRules(_list(RULES, NEXT));
        _post(0, NEXT);
        _post(RULES, RULES);
        _allow(RULES);
        _assertRules(_list(NEXT, RULES));
        _post(0, RULES);
    }

    function test_rulesAreRetiredAndTheOthersKeepTheirOrder() public {
        _allow(NEXT);
        _allow("third");
        vm.expectEmit(address(organization));
        emit IOrganization.RulesRetired(CLEANING, RULES);
        _retire(RULES);
        _assertRules(_list(NEXT, "third"));
        _retire("third");
        _post(0, NEXT);
    }

    function test_theLastRulesStayWhileTheKindIsAllowed() public {
        _allow(0);
        _assertRules(_list(RULES));
        vm.expectRevert(abi.encodeWithSelector(IOrganization.KindWithoutRules.selector, CLEANING));
        _retire(RULES);
        _assertRules(_list(RULES));
    }

    function test_onlyCurrentRulesAreRetired() public {
        vm.expectRevert(abi.encodeWithSelector(IOrganization.RulesNotCurrent.selector, CLEANING, NEXT));
        _retire(NEXT);
    }

    function test_aFewRulesAreCurrentAtATime() public {
        uint256 max = MAX_RULES;
        for (uint256 i = 1; i < max; ++i) {
            _allow(bytes32(i));
        }
        vm.expectRevert(abi.encodeWithSelector(IOrganization.TooManyRules.selector, CLEANING, max));
        _allow(NEXT);
        // One that is current may become the newest all the same.
        _allow(RULES);
        assertEq(organization.currentRules(CLEANING)[max - 1], RULES);
        _retire(RULES);
        _allow(NEXT);
        assertEq(organization.currentRules(CLEANING).length, max);
    }

    function test_peopleJudgeWithOrWithoutRules() public {
        vm.startPrank(admin);
        organization.allowKind("painting", auditorJudge, 0);
        assertEq(organization.currentRules("painting").length, 0);
        TaskRequest memory r = request(1 ether);
        r.kind = "painting";
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskRegistered(
            taskNo(1), address(organization), "painting", 1 ether, WINDOW, WINDOW, ATTEMPTS, 0, "{}"
        );
        organization.registerTask(r);
        organization.allowKind("painting", auditorJudge, NEXT);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.KindWithoutRules.selector, bytes32("painting")));
        organization.retireRules("painting", NEXT);
    }

    function test_rulesEndWithTheirJudgesAndWithTheirKind() public {
        vm.expectEmit(address(organization));
        emit IOrganization.RulesRetired(CLEANING, RULES);
        vm.prank(admin);
        organization.allowKind(CLEANING, auditorJudge, 0);
        _refused(RULES);
        vm.prank(admin);
        organization.allowKind(CLEANING, auditorJudge, NEXT);
        _assertRules(_list(NEXT));
        vm.expectEmit(address(organization));
        emit IOrganization.RulesRetired(CLEANING, NEXT);
        vm.prank(admin);
        organization.disallowKind(CLEANING);
        _assertRules(new bytes32[](0));
        _allow(RULES);
        _assertRules(_list(RULES));
    }

    // -- adversaries --------------------------------------------------------------------------------------

    function test_attack_theAdministratorRetiresTheRulesOfATaskThatIsOpen() public {
        TaskId taskId = _post(0, RULES);
        _allow(NEXT);
        _retire(RULES);
        // Nothing that a later attempt or verdict says names other rules: the first event stands.
        offer(robot1, 80 ether);
        attempt(taskId, false);
        attempt(taskId, true);
        assertState(taskId, TaskState.Settled);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_attack_aCreatorNamesRulesThatAreRetiredOrAnotherKinds() public {
        _allow(NEXT);
        _retire(RULES);
        _refused(RULES);
        vm.prank(admin);
        organization.allowKind(CHARGING, oracleJudge, "charging");
        _refused("charging");
        assertEq(tasks.taskCount(), 0);
    }

    function test_attack_theRulesChangeBetweenSigningAndMining() public {
        // Alice signed while RULES was the newest, and named them.
        _allow(NEXT);
        _post(RULES, RULES);
        _retire(RULES);
        _refused(RULES);
        // Nor do people judge what she left to the oracle's rules.
        vm.prank(admin);
        organization.allowKind(CLEANING, auditorJudge, 0);
        _refused(NEXT);
    }
}
