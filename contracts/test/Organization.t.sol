// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IAccessControl} from "@openzeppelin/contracts/access/IAccessControl.sol";
import {Device, IDeviceRegistry, Revocation} from "../src/interfaces/IDeviceRegistry.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {IMatchingPolicy} from "../src/interfaces/IMatchingPolicy.sol";
import {IOrganization, Windows} from "../src/interfaces/IOrganization.sol";
import {Terms} from "../src/interfaces/IProviders.sol";
import {IServiceManager, ServiceState} from "../src/interfaces/IServiceManager.sol";
import {ITaskManager, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {Texts} from "../src/libraries/Texts.sol";
import {Units} from "../src/libraries/Units.sol";
import {KindId} from "../src/types/KindId.sol";
import {NO_SERVICE, ServiceId} from "../src/types/ServiceId.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {MEMBER_ROLE, OPERATOR_ROLE, TREASURER_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";
import {Possession} from "./Possession.sol";
import {StubPolicy, Way} from "./StubPolicies.sol";

/// @notice A judge that answers with the terms that the test set, and uses as much gas.
contract StubJudge {
    bytes4 private _magic;
    uint32 private _window;
    uint32 private _longest;
    uint256 private _work;

    function say(bytes4 magic, uint32 window, uint32 longest, uint256 work) external {
        (_magic, _window, _longest, _work) = (magic, window, longest, work);
    }

    function termsFor(bytes32) external view returns (bytes4, uint32, uint32) {
        for (uint256 i = 0; i < _work; ++i) {
            // Each look at an account that nobody has looked at costs 2,600 gas.
            assert(address(uint160(i + 1e6)).balance == 0);
        }
        return (_magic, _window, _longest);
    }
}

contract OrganizationTest is Fixture {
    IDeviceRegistry private devices;

    function setUp() public override {
        super.setUp();
        devices = organization.devices();
    }

    function _refusal(address caller, bytes32 role) private pure returns (bytes memory) {
        return abi.encodeWithSelector(IAccessControl.AccessControlUnauthorizedAccount.selector, caller, role);
    }

    // -- as a participant ---------------------------------------------------------------------------------

    function test_itPostsTasksFromItsTreasuryAndGetsTheSurplusBack() public {
        offer(robot1, 80 ether);
        vm.prank(admin);
        TaskId taskId = organization.registerTask(request(100 ether));
        assertEq(tasks.task(taskId).creator, address(organization));
        assertEq(coin.balanceOf(address(organization)), 1900 ether);
        submit(taskId);
        judge(taskId, true);
        assertEq(coin.balanceOf(address(organization)), 1920 ether);
    }

    function test_itCancelsItsTasksForARefund() public {
        vm.startPrank(admin);
        TaskId taskId = organization.registerTask(request(100 ether));
        organization.cancelTask(taskId);
        assertEq(coin.balanceOf(address(organization)), 2000 ether);
    }

    function test_itEarnsWithItsServices() public {
        vm.startPrank(admin);
        ServiceId serviceId = organization.registerService(CLEANING, 80 ether, NO_LIMIT, true, "");
        organization.updateService(serviceId, 90 ether, ServiceState.Active);
        vm.stopPrank();
        TaskId taskId = post(alice, 100 ether);
        vm.prank(admin);
        organization.submitProof(taskId, 1, PROOF, URI);
        judge(taskId, true);
        assertEq(coin.balanceOf(address(organization)), 2090 ether);
    }

    function test_onlyTheOperatorActsInItsName() public {
        bytes memory refusal = _refusal(stranger, OPERATOR_ROLE);
        vm.startPrank(stranger);
        vm.expectRevert(refusal);
        organization.registerTask(request(1 ether));
        vm.expectRevert(refusal);
        organization.cancelTask(taskNo(1));
        vm.expectRevert(refusal);
        organization.registerService(CLEANING, 1 ether, NO_LIMIT, true, "");
        vm.expectRevert(refusal);
        organization.updateService(serviceNo(1), 1 ether, ServiceState.Paused);
        vm.expectRevert(refusal);
        organization.submitProof(taskNo(1), 1, PROOF, URI);
    }

    // -- treasury -----------------------------------------------------------------------------------------

    function test_theTreasurerWithdrawsIncomeAndDeposits() public {
        vm.startPrank(admin);
        vm.expectEmit(address(organization));
        emit IOrganization.Withdrawn(admin, 500 ether);
        organization.withdraw(admin, 500 ether);
        assertEq(coin.balanceOf(admin), 500 ether);
        coin.approve(address(organization), 200 ether);
        vm.expectEmit(address(organization));
        emit IOrganization.Deposited(admin, 200 ether);
        organization.deposit(200 ether);
        assertEq(coin.balanceOf(address(organization)), 1700 ether);
        // The allowance of the escrow is what it was.
        assertEq(coin.allowance(address(organization), address(tasks)), type(uint256).max);
    }

    function test_onlyTheTreasurerMovesTheTreasury() public {
        bytes memory refusal = _refusal(stranger, TREASURER_ROLE);
        vm.startPrank(stranger);
        vm.expectRevert(refusal);
        organization.withdraw(stranger, 1 ether);
        vm.expectRevert(refusal);
        organization.deposit(1 ether);
    }

    // -- rules --------------------------------------------------------------------------------------------

    function test_onlyTheAdministratorRules() public {
        bytes memory refusal = _refusal(stranger, organization.DEFAULT_ADMIN_ROLE());
        vm.startPrank(stranger);
        vm.expectRevert(refusal);
        organization.allowKind("painting", oracleJudge, 0);
        vm.expectRevert(refusal);
        organization.disallowKind(CLEANING);
        vm.expectRevert(refusal);
        organization.retireRules(CLEANING, RULES);
        vm.expectRevert(refusal);
        organization.setPolicy(policy);
        vm.expectRevert(refusal);
        organization.setWindows(CLEANING, windows(SHORTEST, 3 minutes), 1 ether);
        vm.expectRevert(refusal);
        organization.vouchFor(stranger, true);
        vm.expectRevert(refusal);
        organization.rescueTokens(coin, stranger);
        vm.expectRevert(refusal);
        organization.setTerms(Terms(0, 0, 1));
        vm.expectRevert(refusal);
        organization.setMembersOnly(true);
        vm.expectRevert(refusal);
        organization.grantRole(MEMBER_ROLE, stranger);
        vm.expectRevert(refusal);
        organization.revokeRole(MEMBER_ROLE, stranger);
        vm.expectRevert(refusal);
        organization.suspendService(serviceNo(1));
        vm.expectRevert(refusal);
        organization.reinstateService(serviceNo(1));
        vm.expectRevert(refusal);
        organization.suspendProvider(robot1);
        vm.expectRevert(refusal);
        organization.reinstateProvider(robot1);
        vm.expectRevert(refusal);
        Possession.register(organization, robot1, "robot", robot1, "panther1");
        vm.expectRevert(refusal);
        organization.revokeDevice(robot1, Revocation.Superseded);
    }

    function test_aKindThatIsNoLongerAllowedFinishesWhatRuns() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        vm.prank(admin);
        organization.disallowKind(CLEANING);
        submit(taskId);
        judge(taskId, false);
        submit(taskId);
        judge(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_theAdministratorHandsOverInTwoSteps() public {
        vm.prank(admin);
        organization.beginDefaultAdminTransfer(alice);
        assertEq(organization.defaultAdmin(), admin);
        vm.warp(block.timestamp + 1);
        vm.prank(alice);
        organization.acceptDefaultAdminTransfer();
        assertEq(organization.defaultAdmin(), alice);
    }

    function test_aPolicyIsAContract() public {
        vm.expectRevert(abi.encodeWithSelector(IOrganization.InvalidPolicy.selector, stranger));
        vm.prank(admin);
        organization.setPolicy(IMatchingPolicy(stranger));
    }

    function test_aBadPolicyDelaysMatchingButStopsNoVerdict() public {
        for (uint8 way = 0; way <= uint8(type(Way).max); ++way) {
            uint256 snapshot = vm.snapshotState();
            offer(robot1, 80 ether);
            TaskId running = post(alice, 100 ether);
            IMatchingPolicy bad = new StubPolicy(Way(way), 999);
            vm.expectEmit(address(organization));
            emit IOrganization.PolicyChanged(bad);
            vm.prank(admin);
            organization.setPolicy(bad);

            ServiceId serviceId = offer(robot2, 80 ether);
            vm.expectEmit(address(tasks));
            emit ITaskManager.PolicyFailed(following(running));
            TaskId waiting = post(bob, 100 ether);
            assertState(waiting, TaskState.Open);
            submit(running);
            judge(running, false);
            assertState(running, TaskState.Assigned);

            vm.prank(admin);
            organization.setPolicy(policy);
            vm.prank(stranger);
            tasks.matchTask(waiting, NO_SERVICE);
            assertAssigned(waiting, serviceId);
            vm.revertToState(snapshot);
        }
    }

    function test_theAdministratorRenouncesInTwoStepsAsWell() public {
        vm.startPrank(admin);
        organization.beginDefaultAdminTransfer(address(0));
        vm.warp(block.timestamp + 1);
        organization.renounceRole(organization.DEFAULT_ADMIN_ROLE(), admin);
        assertEq(organization.defaultAdmin(), address(0));
    }

    // -- members ------------------------------------------------------------------------------------------

    function test_aMembersOnlyOrganizationTakesTasksAndServicesFromMembers() public {
        vm.expectEmit(address(organization));
        emit IOrganization.MembersOnlyChanged(true);
        vm.prank(admin);
        organization.setMembersOnly(true);
        assertTrue(organization.membersOnly());
        bytes memory refusal = abi.encodeWithSelector(IOrganization.NotMember.selector, alice);
        vm.startPrank(alice);
        vm.expectRevert(refusal);
        tasks.registerTask(request(1 ether));
        vm.expectRevert(refusal);
        services.registerService(CLEANING, 1 ether, NO_LIMIT, true, "");
        vm.stopPrank();

        vm.prank(admin);
        organization.grantRole(MEMBER_ROLE, alice);
        assertTrue(organization.isMember(alice));
        TaskId taskId = post(alice, 1 ether);
        vm.prank(admin);
        organization.revokeRole(MEMBER_ROLE, alice);
        assertFalse(organization.isMember(alice));
        vm.expectRevert(refusal);
        vm.prank(alice);
        tasks.registerTask(request(1 ether));
        vm.prank(alice);
        tasks.cancelTask(taskId);
    }

    function test_theOrganizationIsAtHomeWithItself() public {
        vm.startPrank(admin);
        organization.setMembersOnly(true);
        organization.registerTask(request(1 ether));
        organization.registerService(CHARGING, 1 ether, NO_LIMIT, true, "");
        assertEq(tasks.taskCount() + services.serviceCount(), 2);
    }

    // -- kinds --------------------------------------------------------------------------------------------

    function test_auditorsMayJudgeAKindAlone() public {
        vm.expectEmit(address(organization));
        emit IOrganization.KindAllowed(CLEANING, KindId.wrap(3), auditorJudge, 0, 1 minutes, 30 days);
        vm.prank(admin);
        organization.allowKind(CLEANING, auditorJudge, 0);
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        submit(taskId);
        Finding memory f = finding(taskId, Ruling.Accepted, 80 ether);
        vm.expectRevert(
            abi.encodeWithSelector(ITaskManager.NotJudge.selector, address(oracleJudge), KindId.wrap(3))
        );
        vm.prank(oracle);
        oracleJudge.rule(f, "");
        vm.prank(auditor);
        auditorJudge.rule(f, "");
        assertState(taskId, TaskState.Settled);
    }

    function test_aKindNeedsAJudgeThatJudgesIt() public {
        StubJudge stub = new StubJudge();
        address[4] memory judges = [address(0), alice, address(policy), address(stub)];
        vm.startPrank(admin);
        for (uint256 i = 0; i < 2; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(IOrganization.InvalidJudge.selector, bytes32("painting"), judges[i])
            );
            organization.allowKind("painting", IJudge(judges[i]), 0);
        }
        vm.expectRevert();
        organization.allowKind("painting", IJudge(judges[2]), 0);
        bytes4 magic = IJudge.termsFor.selector;
        (bytes4[3] memory magics, uint32[3] memory windows, uint32[3] memory longest) =
            ([bytes4(0), magic, magic], [uint32(60), 59, 60], [uint32(1 days), 1 days, 30 days + 1]);
        for (uint256 i = 0; i < 3; ++i) {
            stub.say(magics[i], windows[i], longest[i], 0);
            vm.expectRevert(
                abi.encodeWithSelector(
                    IOrganization.InvalidJudge.selector, bytes32("painting"), address(stub)
                )
            );
            organization.allowKind("painting", IJudge(address(stub)), 0);
        }
        stub.say(magic, 60, 1 days, 100);
        vm.expectRevert();
        organization.allowKind("painting", IJudge(address(stub)), 0);
        assertFalse(organization.kindOf("painting").allowed);
        stub.say(magic, 60, 1 days, 0);
        organization.allowKind("painting", IJudge(address(stub)), 0);
        assertTrue(organization.kindOf("painting").allowed);
        assertEq(organization.kindOf("painting").maxCase, 1 days);
    }

    function test_anAuditWindowThatFillsTheCaseLeavesNoVerdictWindow() public {
        Windows memory w = windows(SHORTEST, 3 minutes);
        uint32[2] memory long = [uint32(30 days), type(uint32).max];
        for (uint256 i = 0; i < 2; ++i) {
            w.auditWindow = long[i];
            vm.prank(admin);
            organization.setWindows(CLEANING, w, 1 ether);
            vm.expectRevert(
                abi.encodeWithSelector(
                    IOrganization.InvalidVerdictWindow.selector, CLEANING, WINDOW, 15 minutes, 0
                )
            );
            post(alice, 1 ether);
        }
    }

    function test_onlyTheOrganizationRecordsWhoJudges() public {
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotOrganization.selector, bob));
        vm.prank(bob);
        tasks.recordJudge(KindId.wrap(1), bob, 1 ether);
    }

    function test_aDisallowedKindKeepsItsJudges() public {
        vm.expectEmit(address(organization));
        emit IOrganization.KindDisallowed(CLEANING);
        vm.prank(admin);
        organization.disallowKind(CLEANING);
        assertFalse(organization.kindOf(CLEANING).allowed);
        assertEq(address(organization.judgeNumbered(KindId.wrap(1))), address(oracleJudge));
    }

    function test_aKindSaysHowLongItsTasksMayTake() public {
        uint96[2] memory prices = [uint96(0), 1 gwei + 1];
        uint256 most = Units.max(1 gwei);
        Windows memory w = windows(WINDOW + 1, 3 minutes);
        w.maxWindow = WINDOW + 2;
        vm.startPrank(admin);
        for (uint256 i = 0; i < 2; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(IServiceManager.InvalidPrice.selector, prices[i], 1 gwei, most)
            );
            organization.setWindows(CLEANING, w, prices[i]);
        }
        vm.stopPrank();
        vm.expectEmit(address(organization));
        emit IOrganization.WindowsChanged(CLEANING, w, 1 ether);
        vm.prank(admin);
        organization.setWindows(CLEANING, w, 1 ether);
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganization.InvalidWindow.selector, CLEANING, WINDOW, WINDOW + 1, WINDOW + 2
            )
        );
        post(alice, 1 ether);
    }

    function test_windowsAreBetweenAMinuteAndThirtyDays() public {
        uint32[2][3] memory wrong = [[uint32(59), 1 days], [uint32(1 days), 30 days + 1], [uint32(61), 60]];
        vm.startPrank(admin);
        for (uint256 i = 0; i < wrong.length; ++i) {
            bytes memory refusal = abi.encodeWithSelector(
                IOrganization.InvalidWindows.selector, wrong[i][0], wrong[i][1], 1 minutes, 30 days
            );
            Windows memory w = windows(SHORTEST, 3 minutes);
            (w.minWindow, w.maxWindow) = (wrong[i][0], wrong[i][1]);
            vm.expectRevert(refusal);
            organization.setWindows(CLEANING, w, 1 ether);
            w = windows(SHORTEST, 3 minutes);
            (w.minVerdictWindow, w.maxVerdictWindow) = (wrong[i][0], wrong[i][1]);
            vm.expectRevert(refusal);
            organization.setWindows(CLEANING, w, 1 ether);
        }
        vm.stopPrank();
    }

    function test_theGracePeriodIsAtMostHalfOfTheShortestWindow() public {
        vm.startPrank(admin);
        organization.setWindows(CLEANING, windows(60, 30), 1 ether);
        // None would let anybody end an attempt before its executor can accept it.
        uint16[3] memory wrong = [uint16(0), 40, 25];
        for (uint256 i = 0; i < wrong.length; ++i) {
            vm.expectRevert(abi.encodeWithSelector(IOrganization.InvalidGrace.selector, wrong[i], 10, 30));
            organization.setWindows(CLEANING, windows(60, wrong[i]), 1 ether);
        }
        vm.expectRevert(abi.encodeWithSelector(IOrganization.InvalidGrace.selector, 2560, 10, 2550));
        organization.setWindows(CLEANING, windows(2 hours, 2560), 1 ether);
        vm.stopPrank();
    }

    function test_aKindWithoutAReferencePriceIsNotAllowed() public {
        vm.startPrank(admin);
        organization.setWindows("gardening", windows(SHORTEST, 3 minutes), 0);
        vm.expectRevert(
            abi.encodeWithSelector(IServiceManager.InvalidPrice.selector, 0, 1 gwei, Units.max(1 gwei))
        );
        organization.allowKind("gardening", oracleJudge, RULES);
        vm.stopPrank();
    }

    function test_aKindWithoutWindowsIsNotAllowed() public {
        vm.expectRevert(
            abi.encodeWithSelector(IOrganization.KindWithoutWindows.selector, bytes32("gardening"))
        );
        vm.prank(admin);
        organization.allowKind("gardening", oracleJudge, RULES);
    }

    function test_aKindHasAShortestAndALongestVerdictWindow() public {
        Windows memory w = windows(SHORTEST, 3 minutes);
        (w.minVerdictWindow, w.maxVerdictWindow) = (WINDOW + 1, WINDOW + 2);
        vm.prank(admin);
        organization.setWindows(CLEANING, w, 1 ether);
        assertEq(organization.kindOf(CLEANING).minVerdictWindow, WINDOW + 1);
        assertEq(organization.kindOf(CLEANING).maxVerdictWindow, WINDOW + 2);
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganization.InvalidVerdictWindow.selector, CLEANING, WINDOW, WINDOW + 1, WINDOW + 2
            )
        );
        post(alice, 1 ether);
        (w.minVerdictWindow, w.maxVerdictWindow) = (1 minutes, 30 days);
        vm.prank(admin);
        organization.setWindows(CLEANING, w, 1 ether);
        post(alice, 1 ether);
    }

    // -- devices ------------------------------------------------------------------------------------------

    function test_aDeviceIsRegisteredAndRevokedOnce() public {
        address device = makeAddr("device");
        vm.startPrank(admin);
        vm.expectEmit(address(devices));
        emit IDeviceRegistry.DeviceRegistered(device, "robot", robot1, "panther1", admin);
        Possession.register(organization, device, "robot", robot1, "panther1");
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.DeviceAlreadyRegistered.selector, device));
        Possession.register(organization, device, "bin", robot2, "itrash");

        uint256 registeredAt = block.timestamp;
        vm.warp(registeredAt + 100);
        vm.expectEmit(address(devices));
        emit IDeviceRegistry.DeviceRevoked(device, Revocation.Compromised);
        organization.revokeDevice(device, Revocation.Compromised);
        Device memory d = devices.device(device);
        assertEq(d.role, bytes32("robot"));
        assertEq(d.name, bytes32("panther1"));
        assertEq(d.owner, robot1);
        assertEq(d.registrar, admin);
        assertEq(d.registeredAt, registeredAt);
        assertEq(d.revokedAt, registeredAt + 100);
        assertEq(uint8(d.revocation), uint8(Revocation.Compromised));

        vm.expectRevert(
            abi.encodeWithSelector(IDeviceRegistry.DeviceAlreadyRevoked.selector, device, registeredAt + 100)
        );
        organization.revokeDevice(device, Revocation.Compromised);
    }

    function test_anUnknownDeviceIsAnError() public {
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.UnknownDevice.selector, stranger));
        devices.device(stranger);
    }

    function test_aDeviceNeedsAnAddressARoleAnOwnerAndAName() public {
        _refused(address(0), "robot", robot1, "panther1");
        _refused(robot1, 0, robot1, "panther1");
        _refused(robot1, "robot", address(0), "panther1");
        _refused(robot1, "robot", robot1, 0);
    }

    function _refused(address device, bytes32 role, address owner, bytes32 name) private {
        vm.expectRevert(
            abi.encodeWithSelector(IDeviceRegistry.InvalidDevice.selector, device, role, owner, name)
        );
        vm.prank(admin);
        Possession.register(organization, device, role, owner, name);
    }

    function test_attack_aSecondKeyPosesAsTheBin() public {
        address bin = makeAddr("bin");
        vm.startPrank(admin);
        Possession.register(organization, bin, "bin", address(organization), "itrash");
        assertEq(devices.deviceNamed("bin", "itrash"), bin);
        vm.expectRevert(
            abi.encodeWithSelector(
                IDeviceRegistry.DeviceNameTaken.selector, bytes32("bin"), bytes32("itrash"), bin
            )
        );
        Possession.register(organization, stranger, "bin", stranger, "itrash");
        // Another bin, and another device of that name, are others.
        Possession.register(organization, robot1, "bin", address(organization), "itrash2");
        Possession.register(organization, robot2, "meter", address(organization), "itrash");
    }

    function test_attack_theAdministratorIsAskedByTheOrganizationAlone() public {
        (bytes32 r, bytes32 vs) = _signed(block.chainid, robot2, robot1, 0);
        bytes memory refusal = abi.encodeWithSelector(IDeviceRegistry.NotOrganization.selector, admin);
        vm.startPrank(admin);
        vm.expectRevert(refusal);
        devices.registerDevice(robot2, "robot", robot1, "panther1", r, vs, admin);
        vm.expectRevert(refusal);
        devices.revokeDevice(robot2, Revocation.Compromised);
        vm.stopPrank();
    }

    function test_attack_nobodyRegistersTheKeyOfAnother() public {
        (bytes32 r, bytes32 vs) = _signed(block.chainid, stranger, robot1, 0);
        _notSigned(robot2, robot1, r, vs);
        _notSigned(robot2, robot1, 0, 0);
    }

    function test_attack_aSignatureIsForOneOwnerRegistryAndChain() public {
        (bytes32 r, bytes32 vs) = _signed(block.chainid, robot2, robot1, 0);
        _notSigned(robot2, alice, r, vs);
        (r, vs) = _signed(block.chainid + 1, robot2, robot1, 0);
        _notSigned(robot2, robot1, r, vs);
        (r, vs) = Possession.sign(address(tasks), block.chainid, robot2, robot1, 0);
        _notSigned(robot2, robot1, r, vs);
        (r, vs) = _signed(block.chainid, robot2, robot1, 1);
        _notSigned(robot2, robot1, r, vs);
    }

    function test_aKeyOfTheWrongOwnerIsRegisteredRightAndNoOldSignatureCountsAgain() public {
        (bytes32 r0, bytes32 vs0) = _signed(block.chainid, robot2, alice, 0);
        vm.startPrank(admin);
        organization.registerDevice(robot2, "robot", alice, "panther1", r0, vs0);
        assertEq(devices.deviceNonce(robot2), 1);
        (bytes32 r1, bytes32 vs1) = _signed(block.chainid, robot2, robot1, 1);
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.DeviceAlreadyRegistered.selector, robot2));
        organization.registerDevice(robot2, "bin", robot1, "panther1", r1, vs1);
        vm.expectEmit(address(devices));
        emit IDeviceRegistry.DeviceOwnerChanged(robot2, robot1, admin);
        organization.registerDevice(robot2, "robot", robot1, "panther1", r1, vs1);
        vm.stopPrank();
        assertEq(devices.device(robot2).owner, robot1);
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.NotSignedByDevice.selector, robot2, alice));
        vm.prank(admin);
        organization.registerDevice(robot2, "robot", alice, "panther1", r0, vs0);
        // What its owner pays it counts for nothing from now on.
        ServiceId serviceId = offer(robot2, 80 ether);
        attempt(post(robot1, 100 ether), true);
        assertEq(services.service(serviceId).reputation, 32);
        vm.prank(admin);
        organization.revokeDevice(robot2, Revocation.Superseded);
        (r1, vs1) = _signed(block.chainid, robot2, alice, 2);
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.DeviceAlreadyRegistered.selector, robot2));
        vm.prank(admin);
        organization.registerDevice(robot2, "robot", alice, "panther1", r1, vs1);
    }

    function _signed(uint256 chainId, address device, address owner, uint256 nonce)
        private
        view
        returns (bytes32, bytes32)
    {
        return Possession.sign(address(devices), chainId, device, owner, nonce);
    }

    function _notSigned(address device, address owner, bytes32 r, bytes32 vs) private {
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.NotSignedByDevice.selector, device, owner));
        vm.prank(admin);
        organization.registerDevice(device, "robot", owner, "panther1", r, vs);
    }

    function test_aNameIsFreeForTheNextKeyOnceTheOldOneIsRevoked() public {
        address next = makeAddr("next");
        vm.startPrank(admin);
        Possession.register(organization, robot1, "bin", address(organization), "itrash");
        organization.revokeDevice(robot1, Revocation.Superseded);
        assertEq(devices.deviceNamed("bin", "itrash"), address(0));
        Possession.register(organization, next, "bin", address(organization), "itrash");
        assertEq(devices.deviceNamed("bin", "itrash"), next);
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.DeviceAlreadyRegistered.selector, robot1));
        Possession.register(organization, robot1, "bin", address(organization), "itrash2");
    }

    function test_theRootOfADayIsPostedOnceByTheOwnerOrTheOperator() public {
        address bin = makeAddr("bin");
        vm.startPrank(admin);
        Possession.register(organization, bin, "bin", address(organization), "itrash");
        Possession.register(organization, robot2, "robot", robot1, "panther1");
        uint64 today = uint64(block.timestamp / 1 days);
        vm.expectEmit(address(devices));
        emit IDeviceRegistry.WitnessRoot(bin, today, "root", "store");
        devices.postRoot(bin, today, "root", "store");
        assertEq(devices.rootOf(bin, today), "root");
        vm.expectRevert(
            abi.encodeWithSelector(IDeviceRegistry.RootAlreadyPosted.selector, bin, today, bytes32("root"))
        );
        devices.postRoot(bin, today, "another", "store");
        devices.postRoot(bin, today - 1, "yesterday", "store");
        vm.stopPrank();

        vm.prank(robot1);
        devices.postRoot(robot2, today, "own", "");
        assertEq(devices.rootOf(robot2, today), "own");
    }

    function test_attack_strangersAndOtherDevicesPostNoRoots() public {
        vm.prank(admin);
        Possession.register(organization, robot2, "robot", robot1, "panther1");
        uint64 today = uint64(block.timestamp / 1 days);
        // Not even the device's own key: it signs evidence and sends nothing.
        address[3] memory others = [stranger, robot2, oracle];
        for (uint256 i = 0; i < 3; ++i) {
            vm.expectRevert(
                abi.encodeWithSelector(IDeviceRegistry.NotDeviceOwner.selector, robot2, others[i], robot1)
            );
            vm.prank(others[i]);
            devices.postRoot(robot2, today, "root", "");
        }
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.UnknownDevice.selector, robot3));
        vm.prank(admin);
        devices.postRoot(robot3, today, "root", "");
    }

    function test_aRootIsSomethingAndOfADayThatHasBegun() public {
        uint64 today = uint64(block.timestamp / 1 days);
        vm.startPrank(admin);
        Possession.register(organization, robot2, "robot", robot1, "panther1");
        vm.expectRevert(
            abi.encodeWithSelector(IDeviceRegistry.InvalidRoot.selector, robot2, today, bytes32(0), today)
        );
        devices.postRoot(robot2, today, 0, "");
        vm.expectRevert(
            abi.encodeWithSelector(
                IDeviceRegistry.InvalidRoot.selector, robot2, today + 1, bytes32("root"), today
            )
        );
        devices.postRoot(robot2, today + 1, "root", "");
        vm.expectRevert(abi.encodeWithSelector(Texts.TextTooLong.selector, 8193, 8192));
        devices.postRoot(robot2, today, "root", new string(8193));
    }

    function test_nobodyRevokesAKeyWithoutSayingWhy() public {
        vm.startPrank(admin);
        Possession.register(organization, robot1, "bin", address(organization), "itrash");
        vm.expectRevert(abi.encodeWithSelector(IDeviceRegistry.RevocationWithoutReason.selector, robot1));
        organization.revokeDevice(robot1, Revocation.None);
    }
}
