// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {IProviders, Namers} from "../src/interfaces/IProviders.sol";
import {IServiceManager, Service, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {Cause, ITaskManager, Ruling, TaskRequest, TaskState} from "../src/interfaces/ITaskManager.sol";
import {LowestPrice} from "../src/policies/LowestPrice.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {MEMBER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";

/// @notice Strangers who take work from others without doing it, or make honest robots fail: what it costs, and what it
/// brings. Robots 1 to 3 are proven, newcomers are not.
contract GriefingTest is Fixture {
    uint256 private constant REWARD = 40 ether;
    uint256 private constant PRICE = 30 ether;

    function setUp() public override {
        super.setUp();
        address[2] memory others = [robot2, robot3];
        for (uint256 i = 0; i < 2; ++i) {
            _fund(others[i], 200 ether);
        }
        setTerms(20 ether, 5 ether, 3);
    }

    // -- who is proven ------------------------------------------------------------------------------------

    function test_threeAcceptedTasksOfTwoCreatorsProveAProvider() public {
        address robot = _newcomer(1);
        offer(robot, PRICE);
        attempt(post(alice, REWARD), true);
        attempt(post(alice, REWARD), true);
        assertFalse(providers.isProven(robot));
        TaskId third = post(bob, REWARD);
        submit(third);
        vm.expectEmit(address(providers));
        emit IProviders.ProviderProven(robot);
        judge(third, true);
        assertTrue(providers.isProven(robot));
    }

    function test_attack_oneCreatorProvesNobody() public {
        address robot = _newcomer(1);
        offer(robot, PRICE);
        for (uint256 i = 0; i < 4; ++i) {
            attempt(post(alice, REWARD), true);
        }
        assertFalse(providers.isProven(robot));
        attempt(post(bob, REWARD), true);
        assertTrue(providers.isProven(robot), "the second one");
    }

    function test_threeTasksOfTheOrganizationProveAProvider() public {
        address robot = _newcomer(1);
        offer(robot, PRICE);
        for (uint256 i = 0; i < 3; ++i) {
            assertFalse(providers.isProven(robot));
            vm.prank(admin);
            attempt(organization.registerTask(request(REWARD)), true);
        }
        assertTrue(providers.isProven(robot));
    }

    function test_attack_ownTasksAndFreeOnesProveNobody() public {
        address robot = makeAddr("device");
        _fund(robot, 60 ether);
        offer(robot, 0);
        vm.prank(admin);
        Possession.register(organization, robot, "robot", alice, "mine");
        for (uint256 i = 0; i < 2; ++i) {
            attempt(post(alice, REWARD), true);
            attempt(post(robot, REWARD), true);
            attempt(post(bob, REWARD), true);
        }
        assertFalse(providers.isProven(robot), "its owner's, its own, and two for nothing");
        update(serviceNo(1), PRICE, ServiceState.Active);
        for (uint256 i = 0; i < 2; ++i) {
            attempt(post(alice, REWARD), true);
            attempt(post(robot, REWARD), true);
        }
        assertFalse(providers.isProven(robot), "paid by its owner and by itself");
    }

    function test_theOrganizationVouchesForItsMembersAndForOthers() public {
        address robot = _newcomer(1);
        bytes32 role = MEMBER_ROLE;
        vm.startPrank(admin);
        organization.grantRole(MEMBER_ROLE, robot);
        assertTrue(providers.isProven(robot));
        organization.revokeRole(role, robot);
        assertFalse(providers.isProven(robot));
        vm.expectEmit(address(providers));
        emit IProviders.ProviderVouched(robot, true);
        organization.vouchFor(robot, true);
        assertTrue(providers.isProven(robot));
        vm.stopPrank();
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.NotOrganization.selector, stranger));
        vm.prank(stranger);
        services.vouch(stranger, true);
    }

    function test_aProviderThatIsNoLongerVouchedForHasOneServiceInLine() public {
        for (uint256 i = 0; i < 3; ++i) {
            offer(robot1, PRICE);
        }
        vm.startPrank(admin);
        organization.vouchFor(robot1, false);
        assertEq(_waiting(3), 1);
        organization.vouchFor(robot1, true);
        vm.stopPrank();
        assertEq(_waiting(3), 3, "and all of them again");
    }

    function test_attack_servicesAtWorkOfAProviderThatIsNoLongerVouchedForHoldUpNoMoney() public {
        offer(robot1, PRICE);
        ServiceId second = offer(robot1, PRICE);
        TaskId[3] memory ids = [post(alice, REWARD), post(alice, REWARD), post(bob, REWARD)];
        submit(ids[0]);
        submit(ids[1]);
        vm.prank(admin);
        organization.vouchFor(robot1, false);
        judge(ids[0], true);
        assertState(ids[2], TaskState.Open);
        judge(ids[1], true);
        assertAssigned(ids[2], second);
    }

    function test_aProviderThatHasSleptAndIsNoLongerVouchedForHasItsBondBack() public {
        uint256 before = coin.balanceOf(robot1);
        ServiceId serviceId = _offerByHand(robot1);
        for (uint256 i = 0; i < 3; ++i) {
            TaskId taskId = post(alice, REWARD);
            skip(15 minutes + 1);
            vm.prank(stranger);
            tasks.expireTask(taskId);
            vm.prank(alice);
            tasks.cancelTask(taskId);
        }
        vm.prank(robot1);
        services.wakeUp();
        vm.prank(admin);
        organization.vouchFor(robot1, false);
        assertEq(providers.lockedUntil(robot1), 0);
        update(serviceId, PRICE, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), before);
    }

    // -- tasks that are given back ------------------------------------------------------------------------

    function test_attack_givingBackUsesUpNoAttempt() public {
        TaskId taskId = post(alice, REWARD);
        for (uint256 i = 1; i <= 3; ++i) {
            offer(_newcomer(i), PRICE);
            vm.expectEmit(address(tasks));
            emit ITaskManager.TaskRequeued(taskId, uint8(i), Cause.Abandoned);
            giveBack(taskId);
        }
        offer(robot1, PRICE);
        assertEq(services.providerOf(tasks.task(taskId).serviceId), robot1);
        for (uint256 i = 0; i < ATTEMPTS; ++i) {
            assertState(taskId, TaskState.Assigned);
            attempt(taskId, false);
        }
        assertState(taskId, TaskState.Failed);
    }

    function test_attack_aTaskThatAProviderGaveBackComesToNoneOfItsServices() public {
        ServiceId first = offer(robot1, PRICE);
        offer(robot1, PRICE);
        TaskId taskId = post(alice, REWARD);
        assertAssigned(taskId, first);
        giveBack(taskId);
        assertState(taskId, TaskState.Open);
        update(first, PRICE, ServiceState.Paused);
        update(first, PRICE, ServiceState.Active);
        offer(robot1, PRICE);
        assertState(taskId, TaskState.Open);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ServiceDoesNotFit.selector, taskId, first));
        tasks.matchTask(taskId, first);
        assertAssigned(taskId, offer(robot2, PRICE));
    }

    function test_fromTheFourthProviderOnOnlyProvenOnesAreOfferedATask() public {
        ServiceId busy = offer(robot1, PRICE);
        TaskId running = post(bob, REWARD);
        TaskId taskId = _passedBy(4);
        ServiceId newcomers = offer(_newcomer(5), PRICE);
        assertState(taskId, TaskState.Open);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ServiceDoesNotFit.selector, taskId, newcomers));
        tasks.matchTask(taskId, newcomers);
        assertAssigned(post(alice, REWARD), newcomers);
        attempt(running, true);
        assertAssigned(taskId, busy);
    }

    function test_whereNoProvenServiceIsActiveATaskIsOfferedToEverybody() public {
        ServiceId proven = offer(robot1, PRICE);
        post(bob, REWARD);
        TaskId taskId = _passedBy(4);
        ServiceId newcomers = offer(_newcomer(5), PRICE);
        assertState(taskId, TaskState.Open);
        update(proven, PRICE, ServiceState.Paused);
        tasks.matchTask(taskId, newcomers);
        assertAssigned(taskId, newcomers);
        giveBack(taskId);
        assertAssigned(taskId, offer(_newcomer(6), PRICE));
    }

    /// @dev Four newcomers give a task back, and a proven account has a service at a price that nobody pays.
    function test_attack_aProvenServiceAtAPriceThatNobodyPaysStarvesNoTask() public {
        offer(robot1, 1_000_000 ether);
        TaskId taskId = _passedBy(4);
        uint256 queued = block.timestamp;
        ServiceId honest = offer(_newcomer(5), PRICE);
        assertState(taskId, TaskState.Open);
        assertEq(tasks.task(taskId).deadline, 0, "no window runs");
        vm.warp(queued + 1 hours);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ServiceDoesNotFit.selector, taskId, honest));
        tasks.matchTask(taskId, honest);
        skip(1);
        // Asking the policy begins nothing anew.
        tasks.matchTask(taskId, NO_SERVICE);
        assertState(taskId, TaskState.Open);
        vm.prank(stranger);
        tasks.matchTask(taskId, honest);
        assertAssigned(taskId, honest);
        attempt(taskId, true);
        assertState(taskId, TaskState.Settled);
    }

    /// @dev Nor does a proven account that had the task itself, and is still active.
    function test_attack_aProvenServiceThatHadTheTaskStarvesItNot() public {
        offer(robot1, PRICE);
        TaskId taskId = post(alice, REWARD);
        giveBack(taskId);
        for (uint256 i = 1; i <= 3; ++i) {
            offer(_newcomer(i), PRICE);
            giveBack(taskId);
        }
        ServiceId honest = offer(_newcomer(5), PRICE);
        assertState(taskId, TaskState.Open);
        skip(1 hours + 1);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ServiceDoesNotFit.selector, taskId, serviceNo(1)));
        tasks.matchTask(taskId, serviceNo(1));
        tasks.matchTask(taskId, honest);
        assertAssigned(taskId, honest);
        giveBack(taskId);
        ServiceId next = offer(_newcomer(6), PRICE);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.ServiceDoesNotFit.selector, taskId, next));
        tasks.matchTask(taskId, next);
    }

    /// @dev The residue: eight accounts that have proven themselves end a task for gas.
    function test_eightProvenProvidersThatGiveATaskBackEndIt() public {
        TaskId taskId = post(alice, REWARD);
        for (uint256 i = 1; i <= 8; ++i) {
            address account = _newcomer(i);
            vm.prank(admin);
            organization.vouchFor(account, true);
            ServiceId serviceId = offer(account, PRICE);
            giveBack(taskId);
            assertEq(services.service(serviceId).bond, 20 ether);
        }
        assertState(taskId, TaskState.Failed);
    }

    function test_theEighthProviderEndsATask() public {
        uint256 before = coin.balanceOf(alice);
        TaskId taskId = _passedBy(7);
        assertState(taskId, TaskState.Open);
        offer(_newcomer(8), PRICE);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskFailed(taskId, REWARD, 8, Cause.Abandoned);
        giveBack(taskId);
        assertState(taskId, TaskState.Failed);
        assertEq(coin.balanceOf(alice), before);
    }

    function test_attemptsNobodyAcceptedDoNotCount() public {
        TaskId taskId = post(alice, REWARD);
        for (uint256 i = 1; i <= 4; ++i) {
            _offerByHand(_newcomer(i));
            skip(GRACE + 1);
            tasks.expireTask(taskId);
        }
        assertState(taskId, TaskState.Open);
        assertEq(services.service(serviceNo(4)).bond, 20 ether);
    }

    function test_aTaskThatTwoProvenProvidersGiveUpEnds() public {
        ServiceId first = offer(robot1, PRICE);
        offer(robot2, PRICE);
        TaskId taskId = post(alice, REWARD);
        submit(taskId);
        judgeAs(oracle, taskId, Ruling.GivenUp, 0);
        assertEq(services.service(first).bond, 20 ether, "mild");
        assertEq(services.providerOf(tasks.task(taskId).serviceId), robot2);
        submit(taskId);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskFailed(taskId, REWARD, 2, Cause.GivenUp);
        judgeAs(oracle, taskId, Ruling.GivenUp, 0);
    }

    function test_attack_newcomersThatGiveUpPayThePenaltyAndUseUpAttempts() public {
        ServiceId serviceId = offer(_newcomer(1), PRICE);
        TaskId taskId = post(alice, REWARD);
        uint256 treasury = coin.balanceOf(address(organization));
        for (uint256 i = 1; i <= ATTEMPTS; ++i) {
            assertAssigned(taskId, serviceId);
            submit(taskId);
            if (i == 2) ruleUntil(oracleJudge, taskId, Ruling.GivenUp, 0, block.timestamp + 1);
            else judgeAs(oracle, taskId, Ruling.GivenUp, 0);
            skip(2);
            if (i == 2) tasks.conclude(taskId);
        }
        assertState(taskId, TaskState.Failed);
        assertEq(services.service(serviceId).bond, 5 ether);
        assertEq(services.service(serviceId).failures, 0, "mild");
        assertEq(coin.balanceOf(address(organization)), treasury + 15 ether);
    }

    // -- providers that are not proven --------------------------------------------------------------------

    function test_attack_eightServicesOfOneAccountHoldOneTask() public {
        address griefer = _newcomer(1);
        _fund(griefer, 160 ether);
        for (uint256 i = 0; i < 8; ++i) {
            offer(griefer, PRICE);
        }
        assertEq(_waiting(8), 1);
        ServiceId honest = offer(robot1, PRICE);
        post(alice, REWARD);
        assertAssigned(post(alice, REWARD), honest);
        assertState(post(alice, REWARD), TaskState.Open);
        giveBack(taskNo(1));
        assertEq(_waiting(8), 0, "it rests");
        attempt(taskNo(2), true);
        assertAssigned(taskNo(1), honest);
    }

    function test_aNewcomerChoosesWhichServiceWaits() public {
        address robot = _newcomer(1);
        ServiceId first = offer(robot, PRICE);
        vm.expectEmit(address(services));
        emit IServiceManager.ServiceStoodBack(serviceNo(2));
        ServiceId second = offer(robot, PRICE);
        update(second, PRICE, ServiceState.Active);
        assertEq(services.service(first).place, 0);
        assertAssigned(post(alice, REWARD), second);
        attempt(taskNo(1), true);
        assertAssigned(post(alice, REWARD), second);
    }

    function test_attack_aNewcomerRestsTwiceAsLongEachTime() public {
        address griefer = _newcomer(1);
        ServiceId serviceId = offer(griefer, PRICE);
        uint256 rest = 10 minutes;
        for (uint256 i = 0; i < 9; ++i) {
            TaskId taskId = post(alice, REWARD);
            assertAssigned(taskId, serviceId);
            uint256 until = block.timestamp + rest;
            vm.expectEmit(address(providers));
            emit IProviders.ProviderRests(griefer, until);
            giveBack(taskId);
            assertEq(providers.asleepUntil(griefer), until);
            _cannotTakePart(griefer, serviceId, until);
            vm.warp(until);
            vm.prank(griefer);
            if (i % 2 == 0) services.wakeUp();
            else services.updateService(serviceId, PRICE, ServiceState.Active);
            if (rest < 21 hours) rest *= 2;
        }
        assertEq(rest, 76_800, "21 hours and 20 minutes");
        attempt(post(bob, REWARD), true);
        giveBack(post(alice, REWARD));
        assertEq(providers.asleepUntil(griefer), block.timestamp + 10 minutes, "since a proof was accepted");
    }

    function test_aNewcomerThatRestsIsNotPutIntoLineByAgreeing() public {
        address robot = _newcomer(1);
        ServiceId serviceId = offer(robot, PRICE);
        giveBack(post(alice, REWARD));
        vm.prank(admin);
        organization.allowKind(CLEANING, auditorJudge, RULES);
        vm.prank(robot);
        services.agree(serviceId);
        assertEq(services.service(serviceId).place, 0);
    }

    function test_aNewcomerRestsAfterAMissAndAfterAVoid() public {
        address robot = _newcomer(1);
        ServiceId serviceId = offer(robot, PRICE);
        post(alice, REWARD);
        skip(WINDOW + 1);
        tasks.expireTask(taskNo(1));
        assertEq(providers.asleepUntil(robot), block.timestamp + 10 minutes);
        _return(robot, serviceId);
        submit(taskNo(1));
        judgeAs(oracle, taskNo(1), Ruling.Void, 0);
        assertEq(providers.asleepUntil(robot), block.timestamp + 20 minutes);
        _return(robot, serviceId);
        TaskId taskId = post(alice, REWARD);
        submit(taskId);
        ruleUntil(oracleJudge, taskId, Ruling.Void, 0, block.timestamp + 1);
        assertEq(_waiting(1), 1, "free while the ruling stands");
        skip(2);
        tasks.conclude(taskId);
        assertEq(providers.asleepUntil(robot), block.timestamp + 40 minutes);
        assertEq(_waiting(1), 0);
    }

    function test_attack_bondsThatAreRenewedWaitADay() public {
        address griefer = _newcomer(1);
        ServiceId serviceId = offer(griefer, PRICE);
        vm.prank(griefer);
        providers.setPayout(griefer, stranger);
        giveBack(post(alice, REWARD));
        uint256 until = block.timestamp + 24 hours;
        skip(10 minutes);
        vm.prank(griefer);
        services.updateService(serviceId, PRICE, ServiceState.Retired);
        assertEq(services.service(serviceId).bond, 20 ether);
        for (uint256 i = 0; i < 2; ++i) {
            vm.expectRevert(abi.encodeWithSelector(IServiceManager.BondIsLocked.selector, serviceId, until));
            vm.prank(i == 0 ? griefer : stranger);
            services.updateService(serviceId, PRICE, ServiceState.Retired);
        }
        vm.warp(until);
        vm.prank(stranger);
        services.updateService(serviceId, PRICE, ServiceState.Retired);
        assertEq(coin.balanceOf(stranger), 20 ether);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.ServiceIsRetired.selector, serviceId));
        vm.prank(griefer);
        services.updateService(serviceId, PRICE, ServiceState.Retired);
    }

    /// @dev Giving back, resting, and one task that a friend pays, to have the bond back for the next account.
    function test_attack_anAcceptedTaskDoesNotFreeTheBond() public {
        address griefer = _newcomer(1);
        ServiceId serviceId = offer(griefer, PRICE);
        TaskId taskId = post(alice, REWARD);
        giveBack(taskId);
        vm.prank(alice);
        tasks.cancelTask(taskId);
        uint256 until = block.timestamp + 24 hours;
        for (uint256 i = 0; i < 2; ++i) {
            if (i == 0) _return(griefer, serviceId);
            attempt(post(bob, REWARD), true);
            assertEq(providers.lockedUntil(griefer), until);
            assertEq(providers.asleepUntil(griefer), 0);
        }
        update(serviceId, PRICE, ServiceState.Retired);
        vm.expectRevert(abi.encodeWithSelector(IServiceManager.BondIsLocked.selector, serviceId, until));
        vm.prank(griefer);
        services.updateService(serviceId, PRICE, ServiceState.Retired);
        vm.warp(until);
        update(serviceId, PRICE, ServiceState.Retired);
        assertEq(services.service(serviceId).bond, 0);
    }

    /// @dev Proven by its third proof, it neither rests nor sleeps, whatever it gave back before.
    function test_whoProvesItselfAfterAGiveBackIsAwake() public {
        address robot = _newcomer(1);
        ServiceId serviceId = offer(robot, PRICE);
        giveBack(post(alice, REWARD));
        _return(robot, serviceId);
        attempt(post(bob, REWARD), true);
        attempt(post(bob, REWARD), true);
        attempt(post(alice, REWARD), true);
        assertTrue(providers.isProven(robot));
        assertEq(providers.asleepUntil(robot), 0);
        assertEq(providers.lockedUntil(robot), 0);
        assertAssigned(post(alice, REWARD), serviceId);
        attempt(TaskId.wrap(uint40(tasks.taskCount())), true);
        assertTrue(services.service(serviceId).state == ServiceState.Active);
    }

    function test_aBondIsFreeAtOnceWhereNothingWasGivenBackAndForProvenProviders() public {
        address robot = _newcomer(1);
        uint256 before = coin.balanceOf(robot);
        update(offer(robot, PRICE), PRICE, ServiceState.Retired);
        assertEq(coin.balanceOf(robot), before);
        before = coin.balanceOf(robot1);
        ServiceId serviceId = offer(robot1, PRICE);
        giveBack(post(alice, REWARD));
        update(serviceId, PRICE, ServiceState.Retired);
        assertEq(coin.balanceOf(robot1), before);
    }

    function test_attack_aProvenProviderNeverRestsForWhatItGivesBack() public {
        ServiceId serviceId = offer(robot1, PRICE);
        for (uint256 i = 0; i < 20; ++i) {
            giveBack(post(alice, REWARD));
            assertEq(providers.asleepUntil(robot1), 0);
        }
        assertAssigned(post(bob, REWARD), serviceId);
    }

    // -- lines and queues ---------------------------------------------------------------------------------

    function test_aServiceThatIsPassedOverKeepsItsPlace() public {
        ServiceId first = offer(robot1, PRICE);
        ServiceId second = offer(robot1, PRICE);
        ServiceId third = offer(robot2, PRICE);
        TaskId taskId = post(alice, REWARD);
        assertAssigned(taskId, first);
        uint256 place = services.service(second).place;
        giveBack(taskId);
        assertAssigned(taskId, third);
        assertEq(services.service(second).place, place);
        assertAssigned(post(alice, REWARD), second);
    }

    function test_whatAMatchOverlooksMeetsWhenAnybodyAsks() public {
        for (uint256 i = 0; i < 6; ++i) {
            offer(robot1, PRICE);
        }
        TaskId taskId = post(alice, REWARD);
        ServiceId honest = offer(robot2, PRICE);
        giveBack(taskId);
        assertState(taskId, TaskState.Open);
        vm.prank(stranger);
        tasks.matchTask(taskId, honest);
        assertAssigned(taskId, honest);
    }

    function test_aMatchLooksIntoTheLinesOfOtherPrices() public {
        LowestPrice lowest = LowestPrice(deployed("LowestPrice"));
        vm.prank(admin);
        organization.setPolicy(lowest);
        offer(robot1, 1 ether);
        offer(robot1, 2 ether);
        offer(robot1, 3 ether);
        ServiceId honest = offer(robot2, 4 ether);
        TaskId taskId = post(alice, REWARD);
        giveBack(taskId);
        assertAssigned(taskId, honest);
    }

    function test_matchTaskGivesNobodyWhatDoesNotFit() public {
        TaskId taskId = post(alice, REWARD);
        ServiceId dear = offer(robot1, REWARD + 1 ether);
        vm.prank(robot2);
        ServiceId other = services.registerService(CHARGING, PRICE, NO_LIMIT, true, "");
        address griefer = _newcomer(1);
        ServiceId busy = offer(griefer, PRICE);
        ServiceId back = offer(griefer, PRICE);
        assertAssigned(taskId, busy);
        TaskId second = post(alice, REWARD);
        ServiceId[4] memory unfit = [dear, other, busy, back];
        for (uint256 i = 0; i < 4; ++i) {
            vm.expectRevert(abi.encodeWithSelector(ITaskManager.ServiceDoesNotFit.selector, second, unfit[i]));
            tasks.matchTask(second, unfit[i]);
        }
    }

    /// @dev Proven and not, in lines of their own: a provider that waits longer goes first, proven or not.
    function test_bothLinesAreOneForATaskThatNobodyGaveBack() public {
        ServiceId newcomers = offer(_newcomer(1), PRICE);
        ServiceId proven = offer(robot1, PRICE);
        ServiceId later = offer(_newcomer(2), PRICE);
        assertAssigned(post(alice, REWARD), newcomers);
        assertAssigned(post(alice, REWARD), proven);
        assertAssigned(post(alice, REWARD), later);
    }

    /// @dev A service that never waited in a line has an executor, too.
    function test_aServiceThatStoodBackDoesATaskThatAnybodyGivesIt() public {
        address robot = _newcomer(1);
        ServiceId first = offer(robot, PRICE);
        ServiceId second = offer(robot, PRICE);
        update(first, PRICE, ServiceState.Paused);
        TaskId taskId = post(alice, REWARD);
        assertState(taskId, TaskState.Open);
        tasks.matchTask(taskId, second);
        attempt(taskId, true);
        assertState(taskId, TaskState.Settled);
    }

    // -- windows ------------------------------------------------------------------------------------------

    /// @dev Three tasks of a minute took a robot's bond from 20 to 5, suspended it and halved its reputation.
    function test_attack_threeTasksOfAMinute() public {
        ServiceId serviceId = offer(robot1, PRICE);
        TaskRequest memory r = request(REWARD);
        r.executionWindow = 60;
        for (uint256 i = 0; i < 3; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(
                    IOrganization.InvalidWindow.selector, CLEANING, 60, SHORTEST, uint32(30 days)
                )
            );
            vm.prank(alice);
            tasks.registerTask(r);
        }
        Service memory s = services.service(serviceId);
        assertEq(s.bond, 20 ether);
        assertEq(s.reputation, 32);
        assertTrue(s.state == ServiceState.Active);
    }

    function test_theGracePeriodIsTheKindsAndATaskKeepsIt() public {
        _offerByHand(robot1);
        TaskId taskId = post(alice, REWARD);
        vm.prank(admin);
        organization.setWindows(CLEANING, windows(SHORTEST, 3 minutes), 1 ether);
        skip(GRACE);
        vm.expectRevert();
        tasks.expireTask(taskId);
        skip(1);
        tasks.expireTask(taskId);
        _offerByHand(robot2);
        taskId = post(alice, REWARD);
        skip(15 minutes + 1);
        tasks.expireTask(taskId);
        assertState(taskId, TaskState.Open);
    }

    // -- naming -------------------------------------------------------------------------------------------

    /// @dev A puppet whose money returns put an honest robot to sleep for 21 hours.
    function test_attack_puppetsNameNobody() public {
        ServiceId serviceId = offer(robot1, PRICE);
        address puppet = _newcomer(1);
        TaskRequest memory r = request(REWARD);
        r.serviceId = serviceId.pack();
        bytes memory refusal =
            abi.encodeWithSelector(IProviders.NotNamable.selector, serviceId, puppet, Namers.Proven);
        vm.expectRevert(refusal);
        vm.prank(puppet);
        tasks.registerTask(r);
        (r.serviceId, r.provider) = (0, robot1);
        vm.expectRevert(refusal);
        vm.prank(puppet);
        tasks.registerTask(r);
        // Tasks that name nobody can be given back, at no cost, as often as they come.
        for (uint256 i = 0; i < 10; ++i) {
            TaskId taskId = post(puppet, REWARD);
            giveBack(taskId);
            vm.prank(puppet);
            tasks.cancelTask(taskId);
        }
        assertEq(providers.asleepUntil(robot1), 0);
        assertAssigned(post(alice, REWARD), serviceId);
    }

    function test_aServiceSaysWhoMayNameIt() public {
        ServiceId serviceId = offer(robot1, PRICE);
        address puppet = _newcomer(1);
        _name(alice, serviceId, true);
        _name(puppet, serviceId, false);
        _allow(serviceId, Namers.Anybody);
        _name(puppet, serviceId, true);
        _allow(serviceId, Namers.Nobody);
        _name(alice, serviceId, false);
        _name(robot1, serviceId, true);
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.NotProvider.selector, serviceId, stranger, robot1)
        );
        vm.prank(stranger);
        providers.setNamers(serviceId, Namers.Anybody, 0);
    }

    /// @dev Both are busy, and either may get the task.
    function test_attack_aProviderIsNotNamedByOneOfItsServices() public {
        ServiceId first = offer(robot1, PRICE);
        ServiceId second = offer(robot1, PRICE);
        _allow(first, Namers.Anybody);
        _allow(second, Namers.Nobody);
        post(alice, REWARD);
        post(alice, REWARD);
        address puppet = _newcomer(1);
        _fund(puppet, 60 ether);
        TaskRequest memory r = request(REWARD);
        r.provider = robot1;
        vm.expectRevert(abi.encodeWithSelector(IProviders.NotNamable.selector, second, puppet, Namers.Nobody));
        vm.prank(puppet);
        tasks.registerTask(r);
        _allow(second, Namers.Anybody);
        vm.prank(puppet);
        TaskId taskId = tasks.registerTask(r);
        attempt(taskNo(2), true);
        assertAssigned(taskId, second);
        // What does other work is not asked.
        vm.prank(robot1);
        ServiceId other = services.registerService(CHARGING, PRICE, NO_LIMIT, true, "");
        _allow(other, Namers.Nobody);
        vm.prank(puppet);
        tasks.registerTask(r);
    }

    /// @dev It would be offered to the same again: a task that names somebody ends with what does not count.
    function test_aTaskThatNamesSomebodyEndsWithAnAttemptThatDoesNotCount() public {
        ServiceId serviceId = _offerByHand(robot1);
        for (uint256 i = 0; i < 2; ++i) {
            uint256 before = coin.balanceOf(alice);
            _name(alice, serviceId, true);
            TaskId taskId = taskNo(i + 1);
            if (i == 0) {
                skip(GRACE + 1);
                tasks.expireTask(taskId);
            } else {
                submit(taskId);
                judgeAs(oracle, taskId, Ruling.GivenUp, 0);
            }
            assertState(taskId, TaskState.Failed);
            assertEq(coin.balanceOf(alice), before);
        }
    }

    function test_operatorsSayWhoMayNameTheOrganizationsServices() public {
        setTerms(0, 0, 0);
        vm.prank(admin);
        ServiceId serviceId = organization.registerService(CLEANING, PRICE, NO_LIMIT, true, "");
        address puppet = _newcomer(1);
        _name(puppet, serviceId, false);
        vm.expectRevert(
            abi.encodeWithSelector(
                IServiceManager.NotProvider.selector, serviceId, alice, address(organization)
            )
        );
        vm.prank(alice);
        providers.setNamers(serviceId, Namers.Anybody, 0);
        vm.prank(admin);
        providers.setNamers(serviceId, Namers.Anybody, 0);
        _name(puppet, serviceId, true);
    }

    function test_aServiceRefusesCreatorsWhoseTasksEndVoidTooOften() public {
        ServiceId serviceId = offer(robot1, PRICE);
        vm.prank(robot1);
        providers.setNamers(serviceId, Namers.Proven, 50);
        for (uint256 i = 0; i < 5; ++i) {
            _name(alice, serviceId, true);
            submit(taskNo(i + 1));
            if (i % 2 == 0) judgeAs(oracle, taskNo(i + 1), Ruling.Void, 0);
            else judge(taskNo(i + 1), true);
        }
        TaskRequest memory r = request(REWARD);
        r.provider = robot1;
        vm.expectRevert(
            abi.encodeWithSelector(IProviders.TooManyVoids.selector, serviceId, alice, 60, uint8(50))
        );
        vm.prank(alice);
        tasks.registerTask(r);
        _name(bob, serviceId, true);
        attempt(taskNo(6), true);
        // Its own provider may, and so may alice where the service does not look.
        _name(robot1, serviceId, true);
        attempt(taskNo(7), true);
        vm.prank(robot1);
        providers.setNamers(serviceId, Namers.Proven, 0);
        _name(alice, serviceId, true);
    }

    /// @dev Later tasks count more: who ended well for long is refused soon, and the other way round.
    function test_theShareOfVoidsIsThatOfLaterTasks() public {
        ServiceId serviceId = offer(robot1, PRICE);
        vm.prank(robot1);
        providers.setNamers(serviceId, Namers.Proven, 50);
        for (uint256 i = 1; i <= 64; ++i) {
            _name(alice, serviceId, true);
            attempt(taskNo(i), true);
        }
        uint256 voids = 0;
        for (TaskId taskId = taskNo(65); voids < 33; taskId = following(taskId)) {
            _name(alice, serviceId, true);
            submit(taskId);
            judgeAs(oracle, taskId, Ruling.Void, 0);
            ++voids;
        }
        _name(alice, serviceId, false);
    }

    /// @dev The service works again when its penalty comes back, and the task that named it has ended.
    function test_aNamedTaskThatIsGivenUpEndsAndAServiceThatRanShortWorksAgain() public {
        setTerms(5 ether, 5 ether, 0);
        ServiceId serviceId = offer(robot1, PRICE);
        TaskRequest memory r = request(REWARD);
        r.serviceId = serviceId.pack();
        vm.prank(alice);
        TaskId taskId = tasks.registerTask(r);
        submit(taskId);
        ruleUntil(oracleJudge, taskId, Ruling.GivenUp, 0, block.timestamp + 1);
        assertTrue(services.service(serviceId).state == ServiceState.Short);
        skip(2);
        tasks.conclude(taskId);
        assertState(taskId, TaskState.Failed);
        assertAssigned(post(alice, REWARD), serviceId);
    }

    // -- gas ----------------------------------------------------------------------------------------------

    /// @dev The longest lists, the longest lines and queues, the most prices: what a match costs at most.
    function test_attack_theWorstMatchIsBounded() public {
        setTerms(0, 0, 0);
        TaskId taskId = _passedBy(3);
        for (uint256 i = 0; i < 12; ++i) {
            offer(_newcomer(100 + i), priceOf(uint64(1) << uint64(i), 1 gwei));
        }
        for (uint256 i = 0; i < 4; ++i) {
            offer(robot3, priceOf(uint64(3) << uint64(i), 1 gwei));
        }
        vm.cool(address(tasks));
        vm.cool(address(services));
        vm.cool(address(providers));
        vm.cool(address(tasks.queues()));
        address holder = services.providerOf(tasks.task(taskId).serviceId);
        vm.cool(address(tasks));
        vm.cool(address(services));
        vm.prank(holder);
        uint256 gas = gasleft();
        tasks.abandonTask(taskId, 4);
        assertLt(gas - gasleft(), 250_000);
        assertEq(services.providerOf(tasks.task(taskId).serviceId), robot3);
    }

    // -- helpers ------------------------------------------------------------------------------------------

    /// @dev A task that so many newcomers gave back.
    function _passedBy(uint256 count) private returns (TaskId taskId) {
        taskId = post(alice, REWARD);
        for (uint256 i = 1; i <= count; ++i) {
            offer(_newcomer(i), PRICE);
            giveBack(taskId);
        }
    }

    function _newcomer(uint256 number) private returns (address account) {
        account = makeAddr(string(abi.encodePacked("newcomer", number)));
        _fund(account, 60 ether);
    }

    function _fund(address account, uint256 amount) private {
        vm.prank(bob);
        coin.transfer(account, amount);
        vm.prank(account);
        coin.approve(address(tasks), type(uint256).max);
    }

    function _offerByHand(address provider) private returns (ServiceId serviceId) {
        vm.prank(provider);
        return services.registerService(CLEANING, PRICE, NO_LIMIT, false, "");
    }

    function _return(address provider, ServiceId serviceId) private {
        vm.warp(providers.asleepUntil(provider));
        update(serviceId, PRICE, ServiceState.Active);
    }

    function _cannotTakePart(address provider, ServiceId serviceId, uint256 until) private {
        bytes memory refusal = abi.encodeWithSelector(IProviders.ProviderIsAsleep.selector, provider, until);
        vm.startPrank(provider);
        vm.expectRevert(refusal);
        services.updateService(serviceId, PRICE, ServiceState.Active);
        vm.expectRevert(refusal);
        services.registerService(CLEANING, PRICE, NO_LIMIT, true, "");
        vm.expectRevert(refusal);
        services.wakeUp();
        vm.stopPrank();
        assertEq(services.service(serviceId).place, 0);
    }

    /// @dev Of the first services.
    function _waiting(uint256 count) private view returns (uint256 waiting) {
        for (uint256 i = 1; i <= count; ++i) {
            if (services.service(serviceNo(i)).place != 0) ++waiting;
        }
    }

    function _allow(ServiceId serviceId, Namers namers) private {
        vm.expectEmit(address(providers));
        emit IProviders.NamersChanged(serviceId, namers, 0);
        vm.prank(robot1);
        providers.setNamers(serviceId, namers, 0);
    }

    function _name(address creator, ServiceId serviceId, bool may) private {
        TaskRequest memory r = request(REWARD);
        r.serviceId = serviceId.pack();
        vm.prank(creator);
        (bool done,) = address(tasks).call(abi.encodeCall(ITaskManager.registerTask, (r)));
        assertEq(done, may);
    }
}
