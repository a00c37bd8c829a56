// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Choice, IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Ruling} from "../src/interfaces/ITaskManager.sol";
import {HighestReputation} from "../src/policies/HighestReputation.sol";
import {Finding} from "../src/interfaces/IJudge.sol";
import {NOBODY} from "../src/types/Passed.sol";
import {KindId} from "../src/types/KindId.sol";
import {ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";
import {Outcome} from "../src/interfaces/IProviders.sol";

/// @notice Reputation is what a provider did for others, by what they paid.
contract ReputationTest is Fixture {
    uint8 private constant NEWCOMER = 32;

    function _of(ServiceId serviceId) private view returns (uint8) {
        return services.service(serviceId).reputation;
    }

    /// @dev A task of `creator` for the only service that waits.
    function _work(address creator, bool accepted) private {
        attempt(post(creator, 100 ether), accepted);
    }

    function _own(address device, address owner) private {
        vm.prank(admin);
        Possession.register(organization, device, "wallet", owner, bytes32(uint256(uint160(device))));
    }

    function test_acceptedWorkCountsByWhatWasPaid() public {
        ServiceId little = offer(robot1, 1 ether);
        _work(alice, true);
        assertEq(_of(little), 32, "101 of 201");
        update(little, 60 ether, ServiceState.Active);
        _work(bob, true);
        assertEq(_of(little), 39, "161 of 261");
    }

    function test_workThatIsPaidInPartCountsInPart() public {
        ServiceId serviceId = offer(robot1, 60 ether);
        submit(post(alice, 100 ether));
        judgeAs(oracle, taskNo(1), Ruling.Accepted, 10 ether);
        assertEq(_of(serviceId), 33, "110 of 210");
    }

    function test_rejectedAndLateWorkLowersItByThePrice() public {
        ServiceId serviceId = offer(robot1, 20 ether);
        _work(alice, false);
        assertEq(_of(serviceId), 29, "100 of 220");
        vm.warp(block.timestamp + WINDOW + 1 days);
        tasks.expireTask(taskNo(1));
        assertEq(_of(serviceId), 26, "100 of 240");
    }

    function test_workAtPriceZeroDoesNotCount() public {
        ServiceId serviceId = offer(robot1, 0);
        for (uint256 i = 0; i < 5; ++i) {
            _work(alice, true);
        }
        assertEq(services.service(serviceId).completed, 5);
        assertEq(_of(serviceId), NEWCOMER);
    }

    function test_onesOwnTasksDoNotCount() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        _work(robot1, true);
        assertEq(services.service(serviceId).completed, 1);
        assertEq(_of(serviceId), NEWCOMER);
    }

    function test_whatAnOwnerPaysItsRobotDoesNotCount() public {
        _own(robot1, alice);
        ServiceId serviceId = offer(robot1, 80 ether);
        _work(alice, true);
        assertEq(_of(serviceId), NEWCOMER);
        _work(bob, true);
        assertGt(_of(serviceId), NEWCOMER);
    }

    function test_whatARobotPaysItsOwnerDoesNotCount() public {
        _own(robot1, alice);
        ServiceId serviceId = offer(alice, 80 ether);
        _work(robot1, true);
        assertEq(_of(serviceId), NEWCOMER);
    }

    function test_whatOneOwnersRobotsPayEachOtherDoesNotCount() public {
        _own(robot1, alice);
        _own(robot2, alice);
        ServiceId serviceId = offer(robot2, 80 ether);
        _work(robot1, true);
        assertEq(_of(serviceId), NEWCOMER);
    }

    function test_onlyTheOrganizationRecordsOwners() public {
        vm.prank(robot1);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.NotOrganization.selector, robot1));
        providers.recordOwner(robot1, robot2);
    }

    function test_workThatIsVoidGivenUpOrImpossibleDoesNotCount() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        submit(post(alice, 100 ether));
        judgeAs(oracle, taskNo(1), Ruling.Void, 0);
        submit(post(alice, 100 ether));
        judgeAs(oracle, taskNo(2), Ruling.Impossible, 0);
        submit(post(alice, 100 ether));
        judgeAs(oracle, taskNo(3), Ruling.GivenUp, 0);
        submit(post(alice, 100 ether));
        vm.warp(block.timestamp + WINDOW + AUDIT_WINDOW + 1);
        tasks.conclude(taskNo(4));
        assertEq(_of(serviceId), NEWCOMER);
    }

    function test_whatAuditorsSayCountsLikeAnyOtherRuling() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        submit(post(alice, 100 ether));
        judgeAs(oracle, taskNo(1), Ruling.None, 0);
        assertEq(_of(serviceId), NEWCOMER, "nobody has decided yet");
        judgeAs(auditor, taskNo(1), Ruling.Accepted, 80 ether);
        assertEq(_of(serviceId), 41, "180 of 280");
    }

    function test_aNewServiceHasTheReputationOfItsProvider() public {
        ServiceId first = offer(robot1, 20 ether);
        _work(alice, false);
        update(first, 20 ether, ServiceState.Retired);
        assertEq(_of(offer(robot1, 20 ether)), 29, "100 of 220");
        assertEq(_of(offer(robot2, 20 ether)), NEWCOMER);
    }

    function test_itDecaysByHalfInNinetyDays() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        _work(alice, true);
        assertEq(_of(serviceId), 41, "180 of 280");
        vm.warp(block.timestamp + 90 days);
        assertEq(_of(serviceId), 37, "140 of 240");
        vm.warp(block.timestamp + 90 days);
        assertEq(_of(serviceId), 34, "120 of 220");
        // What is added later is added to what is left.
        update(serviceId, 20 ether, ServiceState.Active);
        _work(alice, true);
        assertEq(_of(serviceId), 37, "140 of 240");
        vm.warp(block.timestamp + 36500 days);
        assertEq(_of(serviceId), NEWCOMER);
    }

    function testFuzz_itDoesNotMatterHowOftenItIsComputed(uint256 price, uint256 first, uint256 second)
        public
    {
        ServiceId often = offer(robot1, bound(price, 1e9, 99e9) * 1 gwei);
        attempt(post(alice, 100 ether), true);
        ServiceId seldom = offer(robot2, services.service(often).price);
        update(often, services.service(often).price, ServiceState.Paused);
        attempt(post(alice, 100 ether), true);
        vm.warp(block.timestamp + bound(first, 0, 400 days));
        update(often, 1 gwei, ServiceState.Active);
        update(seldom, services.service(seldom).price, ServiceState.Paused);
        // So little that only the computing matters.
        attempt(post(alice, 100 ether), true);
        vm.warp(block.timestamp + bound(second, 0, 400 days));
        assertApproxEqAbs(_of(often), _of(seldom), 1);
    }

    function test_aWaitingServiceKeepsItsPlaceAndLeavesTheLineAllTheSame() public {
        vm.startPrank(admin);
        organization.setPolicy(HighestReputation(deployed("HighestReputation")));
        vm.stopPrank();
        ServiceId working = offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        ServiceId waiting = offer(robot1, 80 ether);
        ServiceId newcomer = offer(robot2, 80 ether);
        attempt(taskId, true);
        assertEq(_of(waiting), _of(working), "its provider's");
        assertEq(services.bestIdle(cleaning(), 80 ether, NOBODY, Choice.MostReputable), working);
        update(waiting, 80 ether, ServiceState.Paused);
        update(working, 80 ether, ServiceState.Paused);
        assertEq(services.bestIdle(cleaning(), 80 ether, NOBODY, Choice.MostReputable), newcomer);
        update(waiting, 80 ether, ServiceState.Active);
        assertEq(services.bestIdle(cleaning(), 80 ether, NOBODY, Choice.MostReputable), waiting);
    }

    // -- names for money ----------------------------------------------------------------------------------

    /// @dev The kind's reference price.
    function _refer(uint96 price) private {
        vm.prank(admin);
        organization.setWindows(CLEANING, windows(SHORTEST, 3 minutes), price);
    }

    /// @dev Rejected twenty times, by two creators in turn: a price of 50 each time.
    function _failOften() private returns (ServiceId serviceId) {
        serviceId = offer(robot1, 50 ether);
        for (uint256 i = 0; i < 20; ++i) {
            update(serviceId, 50 ether, ServiceState.Active);
            TaskId taskId = post(i % 2 == 0 ? alice : bob, 50 ether);
            submit(taskId);
            update(serviceId, 50 ether, ServiceState.Paused);
            judge(taskId, false);
            vm.prank(i % 2 == 0 ? alice : bob);
            tasks.cancelTask(taskId);
        }
        update(serviceId, 50 ether, ServiceState.Active);
        assertEq(_of(serviceId), 5, "100 of 1200");
    }

    /// @dev Another account of the provider, which looks like anybody.
    function _puppet() private returns (address puppet) {
        puppet = makeAddr("puppet");
        deal(address(coin), puppet, 100_000 ether);
        vm.prank(puppet);
        coin.approve(address(tasks), type(uint256).max);
    }

    function test_oneDearTaskThatOnePaysOneselfBuysNoName() public {
        _refer(50 ether);
        ServiceId serviceId = _failOften();
        update(serviceId, 100_000 ether, ServiceState.Active);
        attempt(post(_puppet(), 100_000 ether), true);
        assertEq(_of(serviceId), 7, "150 of 1250, and 63 if all of it counted");
    }

    function test_manyTasksOfOneCreatorInADayCountAsOne() public {
        _refer(50 ether);
        ServiceId serviceId = _failOften();
        address puppet = _puppet();
        for (uint256 i = 0; i < 20; ++i) {
            attempt(post(puppet, 50 ether), true);
        }
        assertEq(_of(serviceId), 7, "150 of 1250");
        vm.warp(block.timestamp + 1 days);
        attempt(post(puppet, 50 ether), true);
        assertEq(_of(serviceId), 9, "200 of 1300, less what decayed");
    }

    function test_noCreatorRuinsANameInADay() public {
        ServiceId serviceId = offer(robot1, 50 ether);
        for (uint256 i = 1; i < 4; ++i) {
            post(alice, 50 ether);
            for (uint256 j = 0; j < ATTEMPTS; ++j) {
                attempt(taskNo(i), false);
            }
        }
        assertEq(_of(serviceId), 25, "100 of 250");
        assertEq(services.service(serviceId).rejected, 9);
        assertEq(services.service(serviceId).failures, 9);
    }

    /// @dev Whatever comes first counts, so that neither side has the choice.
    function test_theFirstAttemptOfADayCountsHoweverItEnded() public {
        ServiceId serviceId = offer(robot1, 50 ether);
        _work(alice, true);
        _work(alice, false);
        assertEq(_of(serviceId), 38, "150 of 250");
    }

    function test_workForSeveralCreatorsCountsAsBefore() public {
        _refer(50 ether);
        ServiceId serviceId = offer(robot1, 50 ether);
        for (uint256 i = 0; i < 5; ++i) {
            _work(alice, true);
            _work(bob, i != 4);
        }
        assertEq(_of(serviceId), 50, "550 of 700");
    }

    function test_allWorkForTheOrganizationCounts() public {
        ServiceId serviceId = offer(robot1, 50 ether);
        for (uint256 i = 1; i < 5; ++i) {
            vm.prank(admin);
            attempt(organization.registerTask(request(50 ether)), true);
        }
        assertEq(_of(serviceId), 48, "300 of 400");
    }

    /// @dev What the organization posts meanwhile lets nobody count twice, nor hides whom another day began with.
    function test_workForTheOrganizationIsNotInTheRow() public {
        ServiceId serviceId = offer(robot1, 50 ether);
        for (uint256 i = 0; i < 2; ++i) {
            _work(alice, true);
            vm.prank(admin);
            attempt(organization.registerTask(request(50 ether)), true);
        }
        assertEq(_of(serviceId), 45, "250 of 350");
        vm.warp(block.timestamp + 1 days);
        vm.prank(admin);
        attempt(organization.registerTask(request(50 ether)), true);
        _work(alice, true);
        assertEq(_of(serviceId), 49, "350 of 450, less what decayed");
    }

    function test_theReferencePriceCountsThatHoldsWhenTheAttemptEnds() public {
        _refer(50 ether);
        ServiceId serviceId = offer(robot1, 100 ether);
        submit(post(alice, 100 ether));
        _refer(20 ether);
        update(serviceId, 100 ether, ServiceState.Paused);
        judge(taskNo(1), false);
        assertEq(_of(serviceId), 29, "100 of 220");
        vm.prank(alice);
        tasks.cancelTask(taskNo(1));
        update(serviceId, 100 ether, ServiceState.Active);
        _refer(80 ether);
        _work(bob, true);
        assertEq(_of(serviceId), 38, "180 of 300");
    }

    function test_lateWorkCountsUpToTheReferencePrice() public {
        _refer(20 ether);
        ServiceId serviceId = offer(robot1, 100 ether);
        post(alice, 100 ether);
        vm.warp(block.timestamp + WINDOW + 1);
        tasks.expireTask(taskNo(1));
        assertEq(_of(serviceId), 29, "100 of 220");
    }

    function test_rulingsThatStoodCountUpToTheReferencePrice() public {
        _refer(20 ether);
        ServiceId serviceId = offer(robot1, 100 ether);
        submit(post(alice, 100 ether));
        judgeAs(oracle, taskNo(1), Ruling.None, 0);
        judgeAs(auditor, taskNo(1), Ruling.Accepted, 100 ether);
        assertEq(_of(serviceId), 34, "120 of 220");
    }

    /// @dev Another judge is another number; tasks of the number before are still judged.
    function test_theReferencePriceIsTheKindsWhateverItsNumber() public {
        _refer(20 ether);
        ServiceId before = offer(robot1, 100 ether);
        submit(post(alice, 100 ether));
        vm.startPrank(admin);
        organization.allowKind(CLEANING, auditorJudge, RULES);
        vm.stopPrank();
        _refer(40 ether);
        judge(taskNo(1), false);
        assertEq(_of(before), 26, "100 of 240");
        ServiceId next = offer(robot2, 100 ether);
        submit(post(bob, 100 ether));
        Finding memory found = finding(taskNo(2), Ruling.Accepted, 100 ether);
        vm.prank(auditor);
        auditorJudge.rule(found, "report");
        assertEq(_of(next), 37, "140 of 240");
        assertEq(organization.referencePriceOf(CLEANING), 40 ether);
    }

    /// @dev A judge that was removed rules no more because the price was changed.
    function test_aChangedReferencePriceBringsNoJudgeBack() public {
        KindId number = cleaning();
        vm.prank(admin);
        organization.removeJudge(number);
        _refer(40 ether);
        assertTrue(tasks.isRemoved(number));
    }

    function test_workThatIsTheSameForBothGoesToBothNames() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.startPrank(address(tasks));
        for (uint160 i = 1; i < 4; ++i) {
            services.release(serviceId, Outcome.Rejected, type(uint256).max / 2, address(i), 0);
            services.release(serviceId, Outcome.Completed, type(uint256).max / 2, address(i + 9), 0);
        }
        vm.stopPrank();
        assertEq(_of(serviceId), NEWCOMER);
    }

    function test_itNeverOverflows() public {
        ServiceId serviceId = offer(robot1, 80 ether);
        vm.startPrank(address(tasks));
        for (uint160 i = 1; i < 4; ++i) {
            services.release(serviceId, Outcome.Completed, type(uint256).max / 2, address(i), 0);
        }
        vm.stopPrank();
        assertEq(_of(serviceId), 63);
    }
}
