// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskState, Verdict} from "../src/interfaces/ITaskManager.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What was done to the reference contracts of this field, each by its name, and what happens here.
contract AttackTest is Fixture {
    function _wrongState(uint256 taskId, TaskState current, TaskState expected)
        private
        pure
        returns (bytes memory)
    {
        return abi.encodeWithSelector(ITaskManager.WrongState.selector, taskId, current, expected);
    }

    function test_attack_aStrangerCancelsARunningTask() public {
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotCreator.selector, taskId, stranger, alice));
        vm.prank(stranger);
        tasks.cancelTask(taskId);
        attempt(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_attack_aStrangerOrTheCreatorCancelsAfterTheProof() public {
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotCreator.selector, taskId, stranger, alice));
        vm.prank(stranger);
        tasks.cancelTask(taskId);
        vm.expectRevert(_wrongState(taskId, TaskState.Submitted, TaskState.Open));
        vm.prank(alice);
        tasks.cancelTask(taskId);
        judge(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_attack_aFreeServiceDestroysTheReward() public {
        offer(robot1, 0);
        uint256 taskId = post(alice, 100 ether);
        attempt(taskId, true);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_attack_theExecutorFreesItselfMidTaskAndFreezesTheEscrow() public {
        uint256 serviceId = offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        for (uint8 next = 1; next <= uint8(ServiceState.Retired); ++next) {
            update(serviceId, 80 ether, ServiceState(next));
            assertAssigned(taskId, serviceId);
        }
        vm.warp(block.timestamp + WINDOW + 1);
        vm.prank(stranger);
        tasks.expireTask(taskId);
        vm.prank(alice);
        tasks.cancelTask(taskId);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }

    function test_attack_theExecutorCollectsTwoTasksWithOneService() public {
        uint256 serviceId = offer(robot1, 80 ether);
        uint256 one = post(alice, 100 ether);
        uint256 two = post(bob, 100 ether);
        update(serviceId, 80 ether, ServiceState.Paused);
        update(serviceId, 80 ether, ServiceState.Active);
        assertAssigned(one, serviceId);
        vm.expectRevert(_wrongState(two, TaskState.Open, TaskState.Assigned));
        vm.prank(robot1);
        tasks.submitProof(two, 1, PROOF, URI);
    }

    function test_attack_theSurplusOfRewardOverPriceStaysLocked() public {
        offer(robot1, 1 ether);
        for (uint256 i = 0; i < 500; ++i) {
            attempt(post(alice, 100 ether), true);
        }
        assertEq(coin.balanceOf(address(tasks)), 0);
        assertEq(coin.balanceOf(robot1), 2500 ether);
        assertEq(coin.balanceOf(alice), 1500 ether);
    }

    function test_attack_aVerdictIsAcceptedWithoutAProof() public {
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        vm.startPrank(oracle);
        vm.expectRevert(_wrongState(taskId, TaskState.Assigned, TaskState.Submitted));
        tasks.postVerdict(taskId, 1, 0, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    function test_attack_aVerdictIsAcceptedForAnotherProofThanWasSubmitted() public {
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        submit(taskId);
        bytes32 other = keccak256("other");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ProofMismatch.selector, taskId, PROOF, other));
        vm.prank(oracle);
        tasks.postVerdict(taskId, 1, other, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    function test_attack_theVerdictOnAnEarlierAttemptIsPlayedAgain() public {
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        attempt(taskId, false);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, taskId, 2, 1));
        vm.prank(oracle);
        tasks.postVerdict(taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    function test_attack_theProofOfTheLastTaskCountsForTheNext() public {
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        uint256 taskId = post(alice, 100 ether);
        assertEq(tasks.task(taskId).proofHash, 0);
        vm.expectRevert(_wrongState(taskId, TaskState.Assigned, TaskState.Submitted));
        vm.prank(oracle);
        tasks.postVerdict(taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
    }

    function test_attack_theProofIsReplacedAfterSubmission() public {
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(_wrongState(taskId, TaskState.Submitted, TaskState.Assigned));
        vm.prank(robot1);
        tasks.submitProof(taskId, 1, keccak256("better"), URI);
        assertEq(tasks.task(taskId).proofHash, PROOF);
    }

    function test_attack_cancellingDoesNotRefund() public {
        uint256 taskId = post(alice, 100 ether);
        vm.prank(alice);
        tasks.cancelTask(taskId);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_attack_theIncomeOfTheOrganizationCannotBeWithdrawn() public {
        vm.prank(admin);
        organization.registerService(CLEANING, 80 ether, "");
        uint256 taskId = post(alice, 100 ether);
        vm.prank(admin);
        organization.submitProof(taskId, 1, PROOF, URI);
        judge(taskId, true);
        vm.prank(admin);
        organization.withdraw(bob, 2080 ether);
        assertEq(coin.balanceOf(bob), 4080 ether);
        vm.expectRevert(
            abi.encodeWithSelector(
                IERC20Errors.ERC20InsufficientBalance.selector, address(organization), 0, 1
            )
        );
        vm.prank(admin);
        organization.withdraw(bob, 1);
    }

    function test_attack_eachDepositOverwritesTheAllowance() public {
        vm.prank(alice);
        coin.transfer(admin, 30 ether);
        vm.startPrank(admin);
        coin.approve(address(organization), 30 ether);
        organization.deposit(20 ether);
        organization.registerTask(request(2020 ether));
        organization.deposit(10 ether);
        organization.registerTask(request(10 ether));
        assertEq(coin.balanceOf(address(tasks)), 2030 ether);
    }

    function test_attack_gasGrowsWithEveryTaskEverRegistered() public {
        for (uint256 i = 0; i < 4; ++i) {
            offer(robot1, 0.8 ether);
        }
        uint256[] memory gas = new uint256[](502);
        for (uint256 i = 1; i < gas.length; ++i) {
            uint256 before = gasleft();
            attempt(post(alice, 1 ether), true);
            gas[i] = before - gasleft();
        }
        assertApproxEqRel(gas[100], gas[50], 0.1e18);
        assertApproxEqRel(gas[500], gas[100], 0.1e18);
    }

    function test_attack_theOracleNeverAnswers() public {
        uint256 serviceId = offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        for (uint8 i = 1; i <= ATTEMPTS; ++i) {
            submit(taskId);
            vm.warp(block.timestamp + WINDOW + 1);
            vm.prank(stranger);
            tasks.expireTask(taskId);
        }
        assertState(taskId, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(services.service(serviceId).failures, 0, "not the executor's fault");
        assertAssigned(post(alice, 100 ether), serviceId);
    }

    function test_attack_thePartiesJudgeThemselves() public {
        bytes32 role = organization.ORACLE_ROLE();
        vm.startPrank(admin);
        organization.grantRole(role, robot1);
        organization.grantRole(role, alice);
        vm.stopPrank();
        offer(robot1, 80 ether);
        uint256 taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, taskId, robot1));
        vm.prank(robot1);
        tasks.postVerdict(taskId, 1, PROOF, Verdict.Accepted, 80 ether, REPORT, "", "");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.JudgeIsParty.selector, taskId, alice));
        vm.prank(alice);
        tasks.postVerdict(taskId, 1, PROOF, Verdict.Rejected, 0, REPORT, "", "");
    }

    function test_attack_aWindowThatIsTooShortForTheWorkHarvestsPenalties() public {
        vm.prank(admin);
        organization.setMinWindow(CLEANING, WINDOW);
        setTerms(100 ether, 100 ether, 0);
        offer(robot1, 80 ether);
        vm.prank(admin);
        organization.setMinWindow(CHARGING, 30 days);
        assertEq(organization.kindOf(CLEANING).minWindow, WINDOW);
        // Whoever makes a service fail gains nothing from it: penalties are the treasury's.
        uint256 taskId = post(alice, 100 ether);
        vm.warp(block.timestamp + WINDOW + 1);
        vm.prank(alice);
        tasks.expireTask(taskId);
        assertEq(coin.balanceOf(alice) + coin.balanceOf(address(tasks)), 2000 ether);
        assertEq(coin.balanceOf(address(organization)), 2100 ether);
    }

    function test_attack_manyIdleServicesMakeMatchingDear() public {
        for (uint256 i = 1; i <= 300; ++i) {
            offer(stranger, i * 1 ether);
        }
        uint256 before = gasleft();
        post(alice, 150 ether);
        assertLt(before - gasleft(), 600_000);
    }

    function test_attack_someoneElseOccupiesAService() public {
        offer(robot1, 80 ether);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.NotTaskManager.selector, stranger));
        vm.prank(stranger);
        services.acquire(1, CLEANING, 100 ether, 7);
    }
}
