// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {Math} from "@openzeppelin/contracts/utils/math/Math.sol";
import {Vm} from "forge-std/Vm.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {IProviders} from "../src/interfaces/IProviders.sol";
import {IServiceManager, MAX_SERVICES, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Fault, Hire, ITaskManager, TaskRequest, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {Cause, ITaskQueues} from "../src/interfaces/ITaskQueues.sol";
import {Units} from "../src/libraries/Units.sol";
import {NOBODY} from "../src/types/Passed.sol";
import {KindId} from "../src/types/KindId.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {MEMBER_ROLE, ORACLE_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";

/// @notice What was done to the reference contracts of this field, each by its name, and what happens here.
contract AttackTest is Fixture {
    function _wrongState(TaskId taskId, TaskState current, TaskState expected)
        private
        pure
        returns (bytes memory)
    {
        return abi.encodeWithSelector(ITaskManager.WrongState.selector, taskId, current, expected);
    }

    function test_attack_aStrangerCancelsARunningTask() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotCreator.selector, taskId, stranger, alice));
        vm.prank(stranger);
        tasks.cancelTask(taskId);
        attempt(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_attack_aStrangerOrTheCreatorCancelsAfterTheProof() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
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
        TaskId taskId = post(alice, 100 ether);
        attempt(taskId, true);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_attack_theExecutorFreesItselfMidTaskAndFreezesTheEscrow() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
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
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId one = post(alice, 100 ether);
        TaskId two = post(bob, 100 ether);
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
        TaskId taskId = post(alice, 100 ether);
        vm.startPrank(oracle);
        vm.expectRevert(_wrongState(taskId, TaskState.Assigned, TaskState.Submitted));
        oracleJudge.rule(
            Finding(taskId, 1, 0, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 80 ether, ""), ""
        );
    }

    function test_attack_aVerdictIsAcceptedForAnotherProofThanWasSubmitted() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        bytes32 other = keccak256("other");
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ProofMismatch.selector, taskId, PROOF, other));
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, other, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 80 ether, ""), ""
        );
    }

    function test_attack_theVerdictOnAnEarlierAttemptIsPlayedAgain() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        attempt(taskId, false);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, taskId, 2, 1));
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 80 ether, ""), ""
        );
    }

    function test_attack_theProofOfTheLastTaskCountsForTheNext() public {
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        TaskId taskId = post(alice, 100 ether);
        assertEq(tasks.task(taskId).proofHash, 0);
        vm.expectRevert(_wrongState(taskId, TaskState.Assigned, TaskState.Submitted));
        vm.prank(oracle);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 80 ether, ""), ""
        );
    }

    function test_attack_theProofIsReplacedAfterSubmission() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(_wrongState(taskId, TaskState.Submitted, TaskState.Assigned));
        vm.prank(robot1);
        tasks.submitProof(taskId, 1, keccak256("better"), URI);
        assertEq(tasks.task(taskId).proofHash, PROOF);
    }

    function test_attack_cancellingDoesNotRefund() public {
        TaskId taskId = post(alice, 100 ether);
        vm.prank(alice);
        tasks.cancelTask(taskId);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(coin.balanceOf(address(tasks)), 0);
    }

    function test_attack_theIncomeOfTheOrganizationCannotBeWithdrawn() public {
        vm.prank(admin);
        organization.registerService(CLEANING, 80 ether, NO_LIMIT, true, "");
        TaskId taskId = post(alice, 100 ether);
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

    function doOne() external {
        attempt(post(alice, 1 ether), true);
    }

    function test_attack_gasGrowsWithEveryTaskEverRegistered() public {
        for (uint256 i = 0; i < 4; ++i) {
            offer(robot1, 0.8 ether);
        }
        uint256[] memory gas = new uint256[](502);
        for (uint256 i = 1; i < gas.length; ++i) {
            uint256 before = gasleft();
            // In a frame of its own, so that the memory of this test does not count.
            this.doOne();
            gas[i] = before - gasleft();
        }
        assertApproxEqRel(gas[100], gas[50], 0.1e18);
        assertApproxEqRel(gas[500], gas[100], 0.1e18);
    }

    function test_attack_theOracleNeverAnswers() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.warp(block.timestamp + WINDOW + 1);
        vm.prank(stranger);
        tasks.conclude(taskId);
        vm.warp(tasks.standing(taskId).until + 1);
        vm.prank(stranger);
        tasks.conclude(taskId);
        assertState(taskId, TaskState.Failed);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(services.service(serviceId).failures, 0, "not the executor's fault");
        assertAssigned(post(alice, 100 ether), serviceId);
    }

    function test_attack_thePartiesJudgeThemselves() public {
        bytes32 role = ORACLE_ROLE;
        vm.startPrank(admin);
        organization.grantRole(role, robot1);
        organization.grantRole(role, alice);
        vm.stopPrank();
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsParty.selector, taskId, robot1));
        vm.prank(robot1);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Accepted, Fault.Nobody, 80 ether, ""), ""
        );
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsParty.selector, taskId, alice));
        vm.prank(alice);
        oracleJudge.rule(Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Rejected, Fault.Nobody, 0, ""), "");
    }

    function test_attack_aWindowThatIsTooShortForTheWorkHarvestsPenalties() public {
        vm.prank(admin);
        organization.setWindows(CLEANING, windows(WINDOW, 3 minutes), 1 ether);
        setTerms(100 ether, 100 ether, 0);
        offer(robot1, 80 ether);
        assertEq(organization.kindOf(CLEANING).minWindow, WINDOW);
        // Whoever makes a service fail gains nothing from it: penalties are the treasury's.
        TaskId taskId = post(alice, 100 ether);
        vm.warp(block.timestamp + WINDOW + 1);
        vm.prank(alice);
        tasks.expireTask(taskId);
        assertEq(coin.balanceOf(alice) + coin.balanceOf(address(tasks)), 2000 ether);
        assertEq(coin.balanceOf(address(organization)), 2100 ether);
    }

    function test_attack_aVerdictWindowTooShortForAnyJudgeGetsWorkForNothing() public {
        offer(robot1, 80 ether);
        TaskRequest memory r = request(100 ether);
        (uint32 min, uint32 max) = (15 minutes, 7 days);
        uint32[2] memory windows = [min - 1, max + 1];
        for (uint256 i = 0; i < 2; ++i) {
            r.verdictWindow = windows[i];
            vm.expectRevert(
                abi.encodeWithSelector(
                    IOrganization.InvalidVerdictWindow.selector, CLEANING, windows[i], min, max
                )
            );
            vm.prank(alice);
            tasks.registerTask(r);
        }
        // And where nobody judges in the shortest window, nobody is paid: the creator has what it gave, and no work.
        r.verdictWindow = min;
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(r);
        submit(taskId);
        vm.warp(block.timestamp + min + AUDIT_WINDOW + 1);
        vm.prank(alice);
        tasks.conclude(taskId);
        assertState(taskId, TaskState.Failed);
        assertEq(coin.balanceOf(robot1), 2000 ether);
        assertEq(coin.balanceOf(alice), 2000 ether);
        assertEq(services.service(serviceNo(1)).completed, 0, "nobody judged it");
    }

    function test_attack_theAdministratorRaisesTheBondInFrontOfARegistration() public {
        setTerms(50 ether, 20 ether, 0);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.BondTooHigh.selector, 50 ether, 49 ether));
        vm.prank(robot1);
        services.registerService(CLEANING, 80 ether, 49 ether, true, "");
        vm.prank(robot1);
        services.registerService(CLEANING, 80 ether, 50 ether, true, "");
        assertEq(coin.balanceOf(robot1), 1950 ether);
    }

    function test_attack_theNonceIsKnownWherePrevrandaoAndBlockHashAreConstant() public {
        offer(robot1, 80 ether);
        vm.prevrandao(uint256(1));
        bytes32[3] memory nonces;
        for (uint256 i = 0; i < 3; ++i) {
            uint256 snapshot = vm.snapshotState();
            vm.warp(block.timestamp + i % 2);
            vm.recordLogs();
            post(i < 2 ? alice : bob, 100 ether);
            Vm.Log[] memory logs = vm.getRecordedLogs();
            for (uint256 j = 0; j < logs.length; ++j) {
                if (logs[j].topics[0] != ITaskManager.TaskAssigned.selector) continue;
                (,, nonces[i],) = abi.decode(logs[j].data, (uint8, uint256, bytes32, uint256));
            }
            vm.revertToState(snapshot);
        }
        assertTrue(nonces[0] != nonces[1], "at another time");
        assertTrue(nonces[0] != nonces[2], "by another sender");
    }

    function test_attack_aThiefSubmitsTheHashOfAnothersProofFirst() public {
        offer(stranger, 80 ether);
        offer(robot1, 80 ether);
        TaskId stolen = post(alice, 100 ether);
        TaskId honest = post(bob, 100 ether);
        vm.prank(stranger);
        tasks.submitProof(stolen, 1, PROOF, URI);
        // It takes nothing away: the proof names its own task, by which the oracle refuses it for another.
        vm.prank(robot1);
        tasks.submitProof(honest, 1, PROOF, URI);
        judge(stolen, false);
        judge(honest, true);
        assertEq(coin.balanceOf(stranger), 0);
        assertEq(coin.balanceOf(robot1), 2080 ether);
        assertEq(services.service(serviceNo(2)).rejected, 0);
    }

    function test_attack_oneProviderHoardsWithManyServices() public {
        for (uint256 i = 0; i < MAX_SERVICES; ++i) {
            offer(stranger, 0);
        }
        bytes memory refusal =
            abi.encodeWithSelector(IServiceManager.TooManyServices.selector, stranger, MAX_SERVICES);
        vm.expectRevert(refusal);
        offer(stranger, 0);
        // One that retires at work still holds its task.
        TaskId taskId = post(alice, 100 ether);
        update(serviceNo(1), 0, ServiceState.Retired);
        vm.expectRevert(refusal);
        offer(stranger, 0);
        submit(taskId);
        judge(taskId, true);
        offer(stranger, 0);
        for (uint256 i = 0; i <= MAX_SERVICES; ++i) {
            vm.prank(admin);
            organization.registerService(CLEANING, 1 ether, 0, true, "");
        }
    }

    function test_attack_freeServicesInFrontOfAnHonestOneTakeEveryAttempt() public {
        for (uint256 i = 0; i < MAX_SERVICES; ++i) {
            offer(stranger, 0);
        }
        offer(robot1, 80 ether);
        uint256 taken = 0;
        for (uint256 i = 0; i < 10; ++i) {
            TaskId taskId = post(alice, 100 ether);
            while (state(taskId) == TaskState.Assigned) {
                if (services.providerOf(tasks.task(taskId).serviceId) == robot1) {
                    attempt(taskId, true);
                    continue;
                }
                ++taken;
                vm.warp(block.timestamp + WINDOW + 1);
                tasks.expireTask(taskId);
            }
        }
        assertEq(taken, 1, "and then it rests");
        assertEq(services.service(serviceNo(MAX_SERVICES + 1)).completed, 10);
    }

    function test_attack_aSwitchedOffRobotTakesEveryAttempt() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        for (uint256 i = 1; i < ATTEMPTS; ++i) {
            vm.warp(block.timestamp + WINDOW + 1);
            tasks.expireTask(taskId);
            assertAssigned(taskId, serviceId);
        }
        vm.warp(block.timestamp + WINDOW + 1);
        vm.expectEmit(address(services));
        emit IServiceManager.ServiceFellAsleep(serviceId);
        tasks.expireTask(taskId);
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Paused));
        taskId = post(alice, 100 ether);
        assertState(taskId, TaskState.Open);
        bytes memory refusal =
            abi.encodeWithSelector(IProviders.ProviderIsAsleep.selector, robot1, block.timestamp);
        vm.startPrank(robot1);
        vm.expectRevert(refusal);
        services.updateService(serviceId, 80 ether, ServiceState.Active);
        vm.expectRevert(refusal);
        services.registerService(CLEANING, 80 ether, NO_LIMIT, true, "");
        vm.expectEmit(address(providers));
        emit IProviders.ProviderWokeUp(robot1);
        services.wakeUp();
        services.updateService(serviceId, 80 ether, ServiceState.Active);
        vm.expectRevert(abi.encodeWithSelector(IProviders.ProviderIsAwake.selector, robot1));
        services.wakeUp();
        vm.stopPrank();
        assertAssigned(taskId, serviceId);
    }

    function test_attack_aGarbageProofShowsThatARobotIsThere() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        for (uint256 i = 0; i < 3; ++i) {
            TaskId taskId = post(alice, 100 ether);
            attempt(taskId, false);
            attempt(taskId, false);
            vm.warp(block.timestamp + WINDOW + 1);
            tasks.expireTask(taskId);
        }
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Paused));
    }

    function test_attack_wakingUpAgainAndAgain() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        uint256[4] memory waits = [uint256(0), 10 minutes, 20 minutes, 40 minutes];
        for (uint256 i = 0; i < waits.length; ++i) {
            _sleep(post(alice, 100 ether));
            uint256 until = block.timestamp + waits[i];
            assertEq(providers.asleepUntil(robot1), until);
            vm.startPrank(robot1);
            if (waits[i] != 0) {
                vm.warp(until - 1);
                vm.expectRevert(abi.encodeWithSelector(IProviders.ProviderIsAsleep.selector, robot1, until));
                services.wakeUp();
                vm.warp(until);
            }
            services.wakeUp();
            services.updateService(serviceId, 80 ether, ServiceState.Active);
            vm.stopPrank();
        }
        attempt(post(alice, 100 ether), true);
        _sleep(post(alice, 100 ether));
        assertEq(providers.asleepUntil(robot1), block.timestamp, "accepted work begins the count anew");
    }

    function test_attack_aProviderThatWorksSleepsOn() public {
        offer(robot1, 80 ether);
        ServiceId other = offer(robot1, 90 ether);
        TaskRequest memory r = request(100 ether);
        r.executionWindow = 1 days;
        vm.prank(alice);
        TaskId taken = tasks.registerTask(r);
        TaskId missed = post(alice, 100 ether);
        assertAssigned(missed, other);
        _sleep(missed);
        assertGt(providers.asleepUntil(robot1), 0);
        attempt(taken, true);
        assertEq(providers.asleepUntil(robot1), 0, "an accepted proof wakes");
    }

    function test_attack_aNewServiceForgetsFailures() public {
        setTerms(0, 0, 3);
        ServiceId first = offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), false);
        attempt(taskNo(1), false);
        update(first, 80 ether, ServiceState.Retired);
        ServiceId second = offer(robot1, 80 ether);
        assertEq(services.service(second).failures, 2);
        attempt(taskNo(1), false);
        assertEq(uint8(services.service(second).state), uint8(ServiceState.Suspended));
    }

    /// @dev All attempts at the task pass without a proof.
    function _sleep(TaskId taskId) private {
        while (state(taskId) == TaskState.Assigned) {
            vm.warp(tasks.task(taskId).deadline + 1);
            tasks.expireTask(taskId);
        }
    }

    function test_attack_theOrganizationsDocksFallAsleep() public {
        vm.prank(admin);
        ServiceId serviceId = organization.registerService(CLEANING, 80 ether, 0, true, "");
        for (uint256 i = 0; i < 2; ++i) {
            TaskId taskId = post(alice, 100 ether);
            while (state(taskId) == TaskState.Assigned) {
                vm.warp(block.timestamp + WINDOW + 1);
                tasks.expireTask(taskId);
            }
        }
        assertEq(uint8(services.service(serviceId).state), uint8(ServiceState.Active));
    }

    function test_attack_manyIdleServicesMakeMatchingDear() public {
        for (uint256 i = 1; i <= 300; ++i) {
            offer(address(uint160(1000 + i)), i * 1 ether);
        }
        uint256 before = gasleft();
        post(alice, 150 ether);
        assertLt(before - gasleft(), 600_000);
    }

    /// @dev The services that make the way to the honest one longest: their levels differ from its level in one bit.
    function test_attack_servicesThatNobodyPaysMakeTasksDearer() public {
        assertLt(Units.levelFor(Units.max(1 gwei), 1 gwei), 1 << 14, "levels of a kind");
        offer(robot1, 80 ether);
        attempt(post(alice, 100 ether), true);
        uint256 alone = _gasOfOne();
        uint64 level = Units.levelFor(80 ether, 1 gwei);
        for (uint160 i = 0; i < 66; ++i) {
            uint64 near = i < 13 ? level ^ uint64(1 << i) : uint64(uint256(keccak256(abi.encode(i))) % 13_000);
            offer(address(0xbad00 + i / 8), Math.min(priceOf(near, 1 gwei), Units.max(1 gwei)));
        }
        // The first pays for what the others changed.
        _gasOfOne();
        assertLt(_gasOfOne(), alone * 7 / 4);
    }

    function _gasOfOne() private returns (uint256 gas) {
        gas = gasleft();
        attempt(post(alice, 80 ether), true);
        gas -= gasleft();
    }

    function test_attack_whoGivesUpItsMembershipKeepsItsPlaceInLine() public {
        bytes32 role = MEMBER_ROLE;
        vm.startPrank(admin);
        organization.setMembersOnly(true);
        organization.grantRole(MEMBER_ROLE, robot1);
        organization.grantRole(MEMBER_ROLE, robot2);
        organization.grantRole(MEMBER_ROLE, alice);
        vm.stopPrank();
        ServiceId gone = offer(robot1, 1 ether);
        ServiceId here = offer(robot2, 1 ether);
        vm.prank(robot1);
        organization.renounceRole(role, robot1);
        assertEq(uint8(services.service(gone).state), uint8(ServiceState.Suspended));
        assertAssigned(post(alice, 10 ether), here);
    }

    function test_attack_someoneElseOccupiesAService() public {
        offer(robot1, 80 ether);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.NotTaskManager.selector, stranger));
        vm.prank(stranger);
        services.reserve(serviceNo(1), KindId.wrap(1), 100 ether, NOBODY, taskNo(7), Hire.None);
    }

    /// @dev Puts another task before it, takes it away, ends it, hides who had it, or uses up its creator's good name.
    function test_attack_someoneElseMovesTasksThatWait() public {
        TaskId taskId = post(alice, 100 ether);
        ITaskQueues queues = tasks.queues();
        bytes[5] memory calls = [
            abi.encodeCall(ITaskQueues.put, (taskNo(7), cleaning(), 0, 200 ether, NOBODY)),
            abi.encodeCall(ITaskQueues.remove, (taskId, cleaning(), 0, false)),
            abi.encodeCall(ITaskQueues.take, (serviceNo(1), false)),
            abi.encodeCall(ITaskQueues.endAttempt, (taskId, serviceNo(1), Cause.Abandoned, alice, false)),
            abi.encodeCall(ITaskQueues.hire, (alice, 1, address(0), CLEANING, 100 ether))
        ];
        offer(robot1, 120 ether);
        for (uint256 i = 0; i < calls.length; ++i) {
            vm.prank(stranger);
            (bool success, bytes memory answer) = address(queues).call(calls[i]);
            assertFalse(success);
            assertEq(answer, abi.encodeWithSelector(ITaskQueues.NotTaskManager.selector, stranger));
        }
        assertEq(queues.oldestOpen(NO_SERVICE, cleaning(), 0), taskId);
        assertAssigned(taskId, offer(robot2, 80 ether));
    }

    /// @dev Before there is a proof, and after its case.
    function test_attack_anAuditorRulesWithoutACase() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        Finding memory f;
        (f.taskId, f.attempt, f.ruling) = (taskId, 1, Ruling.Rejected);
        vm.expectRevert(_wrongState(taskId, TaskState.Assigned, TaskState.Submitted));
        vm.prank(auditor);
        auditorJudge.ruleFor(oracleJudge, f, "");
        attempt(taskId, true);
        vm.expectRevert(_wrongState(taskId, TaskState.Settled, TaskState.Submitted));
        vm.prank(auditor);
        auditorJudge.ruleFor(oracleJudge, f, "");
    }
}
