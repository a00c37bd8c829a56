// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {Budget, IOrganization, MAX_PAUSE} from "../src/interfaces/IOrganization.sol";
import {TaskState} from "../src/interfaces/ITaskManager.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {GUARDIAN_ROLE, OPERATOR_ROLE, ORACLE_ROLE, TREASURER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What operators and treasurers may take out of the treasury, and what a guardian may stop.
contract BudgetsTest is Fixture {
    address private immutable guardian = makeAddr("guardian");
    bytes32 private operatorRole;
    bytes32 private treasurerRole;

    function setUp() public override {
        super.setUp();
        (operatorRole, treasurerRole) = (OPERATOR_ROLE, TREASURER_ROLE);
        bytes32 guardianRole = GUARDIAN_ROLE;
        vm.prank(admin);
        organization.grantRole(guardianRole, guardian);
    }

    function _overBudget(bytes32 role, uint256 amount, uint256 left, uint256 until)
        private
        pure
        returns (bytes memory)
    {
        return abi.encodeWithSelector(IOrganization.OverBudget.selector, role, amount, left, until);
    }

    // -- budgets ------------------------------------------------------------------------------------------

    function test_theTreasurerCannotDrainTheTreasury() public {
        vm.startPrank(admin);
        vm.expectEmit(address(organization));
        emit IOrganization.BudgetChanged(treasurerRole, 100 ether, 1 days);
        organization.setBudget(treasurerRole, 100 ether, 1 days);
        uint256 until = block.timestamp + 1 days;
        organization.withdraw(bob, 70 ether);
        vm.expectRevert(_overBudget(treasurerRole, 31 ether, 30 ether, until));
        organization.withdraw(bob, 31 ether);
        organization.withdraw(bob, 30 ether);
        vm.warp(until - 1);
        vm.expectRevert(_overBudget(treasurerRole, 1, 0, until));
        organization.withdraw(bob, 1);
        vm.warp(until);
        organization.withdraw(bob, 100 ether);
        Budget memory budget = organization.budgetOf(treasurerRole);
        assertEq(abi.encode(budget), abi.encode(Budget(100 ether, 1 days, uint40(until), 100 ether)));
    }

    function test_theOperatorCannotLockTheTreasury() public {
        setTerms(40 ether, 0, 0);
        vm.startPrank(admin);
        organization.setBudget(operatorRole, 100 ether, 1 days);
        uint256 until = block.timestamp + 1 days;
        TaskId taskId = organization.registerTask(request(50 ether));
        organization.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        vm.expectRevert(_overBudget(operatorRole, 11 ether, 10 ether, until));
        organization.registerTask(request(11 ether));
        vm.expectRevert(_overBudget(operatorRole, 40 ether, 10 ether, until));
        organization.registerService(CLEANING, 1 ether, NO_LIMIT, true, "");
        // What comes back was locked all the same.
        organization.cancelTask(taskId);
        vm.expectRevert(_overBudget(operatorRole, 11 ether, 10 ether, until));
        organization.registerTask(request(11 ether));
    }

    function test_budgetsOfTwoRolesAreApart() public {
        vm.startPrank(admin);
        organization.setBudget(operatorRole, 0, 1 days);
        organization.withdraw(bob, 1500 ether);
        vm.expectRevert(_overBudget(operatorRole, 1, 0, block.timestamp + 1 days));
        organization.registerTask(request(1));
    }

    function test_aPeriodOfNothingLimitsNothing() public {
        vm.startPrank(admin);
        organization.setBudget(treasurerRole, 1 ether, 1 days);
        organization.setBudget(treasurerRole, 0, 0);
        organization.withdraw(bob, 2000 ether);
    }

    function test_onlyTheAdministratorSetsBudgetsAndOnlyWhereTheyMeanSomething() public {
        bytes32 adminRole = organization.DEFAULT_ADMIN_ROLE();
        bytes32 oracleRole = ORACLE_ROLE;
        vm.expectRevert(
            abi.encodeWithSelector(
                IAccessControl.AccessControlUnauthorizedAccount.selector, stranger, adminRole
            )
        );
        vm.prank(stranger);
        organization.setBudget(treasurerRole, 1, 1);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.RoleWithoutBudget.selector, oracleRole));
        vm.prank(admin);
        organization.setBudget(oracleRole, 1, 1);
    }

    // -- the guardian -------------------------------------------------------------------------------------

    function test_aGuardianStopsNewTasksAndNothingElse() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId running = post(alice, 100 ether);
        TaskId waiting = post(bob, 100 ether);
        vm.expectEmit(address(organization));
        emit IOrganization.TasksPaused(guardian, block.timestamp + 1 days);
        vm.prank(guardian);
        organization.pauseTasks(1 days);
        uint256 until = block.timestamp + 1 days;
        assertEq(organization.pausedUntil(), until);

        vm.expectRevert(abi.encodeWithSelector(IOrganization.TasksArePaused.selector, until));
        post(alice, 1 ether);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.TasksArePaused.selector, until));
        vm.prank(admin);
        organization.registerTask(request(1 ether));

        // What runs is proven, judged and paid; what waits is assigned and expires; money is withdrawn.
        attempt(running, true);
        assertState(running, TaskState.Settled);
        assertAssigned(waiting, serviceId);
        vm.warp(block.timestamp + WINDOW + 1);
        tasks.expireTask(waiting);
        offer(robot2, 90 ether);
        vm.prank(admin);
        organization.withdraw(bob, 1 ether);

        vm.warp(until);
        post(alice, 1 ether);
    }

    function test_pausesAreShortAndFarApart() public {
        uint32 max = MAX_PAUSE;
        vm.startPrank(guardian);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.InvalidPause.selector, max + 1, max));
        organization.pauseTasks(max + 1);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.InvalidPause.selector, 0, max));
        organization.pauseTasks(0);
        organization.pauseTasks(max);
        uint256 earliest = block.timestamp + 2 * uint256(max);
        vm.warp(earliest - 1);
        vm.expectRevert(abi.encodeWithSelector(IOrganization.PausedRecently.selector, earliest));
        organization.pauseTasks(1);
        vm.warp(earliest);
        organization.pauseTasks(1);
    }

    function test_guardianAndAdministratorEndAPause() public {
        vm.prank(guardian);
        organization.pauseTasks(1 days);
        uint256 ended = block.timestamp + 1 hours;
        vm.warp(ended);
        vm.expectEmit(address(organization));
        emit IOrganization.TasksResumed(admin);
        vm.prank(admin);
        organization.resumeTasks();
        post(alice, 1 ether);
        // The time between two pauses counts from there, whoever says that it ends again.
        vm.warp(ended + 1 hours);
        vm.startPrank(guardian);
        organization.resumeTasks();
        uint256 earliest = ended + MAX_PAUSE;
        vm.expectRevert(abi.encodeWithSelector(IOrganization.PausedRecently.selector, earliest));
        organization.pauseTasks(1);
    }

    function test_nobodyElsePausesOrResumes() public {
        bytes32 guardianRole = GUARDIAN_ROLE;
        bytes32 adminRole = organization.DEFAULT_ADMIN_ROLE();
        bytes4 refusal = IAccessControl.AccessControlUnauthorizedAccount.selector;
        vm.expectRevert(abi.encodeWithSelector(refusal, admin, guardianRole));
        vm.prank(admin);
        organization.pauseTasks(1 days);
        vm.expectRevert(abi.encodeWithSelector(refusal, stranger, adminRole));
        vm.prank(stranger);
        organization.resumeTasks();
    }
}
