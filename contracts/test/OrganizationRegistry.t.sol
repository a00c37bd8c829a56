// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {Test} from "forge-std/Test.sol";
import {IECoin} from "../src/IECoin.sol";
import {Organization} from "../src/Organization.sol";
import {Cradle, OrganizationRegistry} from "../src/OrganizationRegistry.sol";
import {SignedRequests} from "../src/SignedRequests.sol";
import {TaskManager} from "../src/TaskManager.sol";
import {Founding, IOrganizationRegistry, Part} from "../src/interfaces/IOrganizationRegistry.sol";
import {Terms} from "../src/interfaces/IProviders.sol";
import {AUDITOR_ROLE, ORACLE_ROLE} from "../src/types/Roles.sol";
import {Deployed} from "./Deployed.sol";

/// @notice Organizations are founded in few transactions, at addresses that are known before.
contract OrganizationRegistryTest is Deployed, Test {
    bytes32 private constant COIN = "IECoin";
    bytes32 private constant POLICY = "FirstComeFirstServed";
    bytes32 private constant ORGANIZATION = "Organization";
    bytes32 private constant SERVICES = "ServiceManager";
    bytes32 private constant TASKS = "TaskManager";
    bytes32 private constant LAB = "lab";

    address private immutable alice = makeAddr("alice");
    address private immutable bob = makeAddr("bob");

    OrganizationRegistry private registry;
    bytes32[] private names;
    bytes[] private codes;

    function setUp() public {
        names = [COIN, POLICY, ORGANIZATION, SERVICES, TASKS];
        codes = [
            codeOf("IECoin"),
            codeOf("FirstComeFirstServed"),
            codeOf("Organization"),
            codeOf("ServiceManager"),
            codeOf("TaskManager")
        ];
        bytes32[] memory hashes = new bytes32[](codes.length);
        for (uint256 i = 0; i < codes.length; ++i) {
            hashes[i] = keccak256(codes[i]);
        }
        registry = OrganizationRegistry(deployed("OrganizationRegistry", abi.encode(names, hashes)));
    }

    function _at(address founder, uint32 number, bytes32 part) private view returns (address) {
        return registry.addressOf(founder, LAB, number, part);
    }

    /// @dev Contracts `from` to before `to` of the founder's organization, in an order in which they can be created.
    function _parts(address founder, uint32 number, uint256 from, uint256 to)
        private
        view
        returns (Part[] memory parts)
    {
        address organization = _at(founder, number, ORGANIZATION);
        address services = _at(founder, number, SERVICES);
        address tasks = _at(founder, number, TASKS);
        bytes[] memory arguments = new bytes[](5);
        arguments[0] = abi.encode(new address[](0), new uint256[](0));
        arguments[2] = abi.encode(
            _at(founder, number, COIN),
            services,
            tasks,
            _at(founder, number, POLICY),
            founder,
            uint48(0),
            Terms(0, 0, 0)
        );
        arguments[3] = abi.encode(organization, tasks);
        arguments[4] = abi.encode(organization, services);
        parts = new Part[](to - from);
        for (uint256 i = from; i < to; ++i) {
            parts[i - from] = Part(names[i], codes[i], arguments[i]);
        }
    }

    function _create(address founder, uint32 number, uint256 from, uint256 to) private {
        Part[] memory parts = _parts(founder, number, from, to);
        vm.prank(founder);
        registry.create(LAB, number, parts);
    }

    function _assertWorks(address founder, uint32 number) private view {
        Organization organization = Organization(_at(founder, number, ORGANIZATION));
        assertEq(address(organization.tasks()), _at(founder, number, TASKS));
        assertEq(address(organization.services()), _at(founder, number, SERVICES));
        assertEq(
            address(SignedRequests(TaskManager(_at(founder, number, TASKS)).signedRequests()).tasks()),
            _at(founder, number, TASKS)
        );
        assertEq(organization.defaultAdmin(), founder);
    }

    function test_contractsThatNameEachOtherAreWhereTheyWereSaidToBe() public {
        _create(alice, 0, 0, 5);
        _assertWorks(alice, 0);
    }

    function test_itGoesOnWhereItWasInterruptedAndAgainChangesNothing() public {
        _create(alice, 0, 0, 3);
        assertEq(_at(alice, 0, TASKS).code.length, 0);
        bytes32 before = _at(alice, 0, ORGANIZATION).codehash;
        _create(alice, 0, 0, 5);
        _assertWorks(alice, 0);
        _create(alice, 0, 2, 5);
        assertEq(_at(alice, 0, ORGANIZATION).codehash, before);
        assertEq(registry.organizationCount(), 1);
    }

    function test_foundersNamesAndNumbersHaveTheirOwnContracts() public {
        _create(alice, 0, 0, 5);
        _create(alice, 1, 0, 5);
        vm.roll(block.number + 3);
        _create(bob, 0, 0, 5);
        _assertWorks(alice, 0);
        _assertWorks(alice, 1);
        _assertWorks(bob, 0);
        assertNotEq(_at(alice, 0, TASKS), _at(alice, 1, TASKS));
        assertNotEq(_at(alice, 0, TASKS), _at(bob, 0, TASKS));
        assertNotEq(_at(alice, 0, TASKS), registry.addressOf(alice, "other", 0, TASKS));
        assertEq(registry.organizationCount(), 3);
        Founding memory second = registry.organization(1);
        Founding memory third = registry.organization(2);
        assertEq(second.founder, alice);
        assertEq(second.number, 1);
        assertEq(third.founder, bob);
        assertEq(third.name, LAB);
        assertEq(third.foundedIn, block.number);
        assertEq(registry.foundedIn(bob, LAB, 0), block.number);
        assertEq(registry.foundedIn(alice, LAB, 1), second.foundedIn);
        assertLt(second.foundedIn, third.foundedIn);
        assertEq(registry.foundedIn(bob, LAB, 1), 0);
    }

    function test_nobodyCreatesInAnothersName() public {
        address theirs = _at(alice, 0, COIN);
        // Only the caller's own addresses follow from what it calls.
        _create(bob, 0, 0, 5);
        assertEq(theirs.code.length, 0);
        _create(alice, 0, 0, 5);
        _assertWorks(alice, 0);
    }

    function test_otherCodeIsRefused() public {
        Part[] memory parts = _parts(alice, 0, 0, 1);
        parts[0].code = bytes.concat(parts[0].code, hex"00");
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganizationRegistry.OtherCode.selector, COIN, keccak256(parts[0].code), keccak256(codes[0])
            )
        );
        registry.create(LAB, 0, parts);
        parts = _parts(alice, 0, 0, 1);
        parts[0].name = TASKS;
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganizationRegistry.OtherCode.selector, TASKS, keccak256(codes[0]), keccak256(codes[4])
            )
        );
        registry.create(LAB, 0, parts);
        parts[0].name = "unheard of";
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganizationRegistry.OtherCode.selector,
                bytes32("unheard of"),
                keccak256(codes[0]),
                bytes32(0)
            )
        );
        registry.create(LAB, 0, parts);
    }

    function test_anEmptyPartIsRefused() public {
        Part[] memory parts = new Part[](1);
        vm.expectRevert(
            abi.encodeWithSelector(
                IOrganizationRegistry.OtherCode.selector, bytes32(0), keccak256(""), bytes32(0)
            )
        );
        registry.create(LAB, 0, parts);
    }

    function test_otherArgumentsAreToldFromTheSameAgain() public {
        _create(alice, 0, 0, 5);
        Part[] memory parts = _parts(alice, 0, 2, 3);
        parts[0].arguments = bytes.concat(parts[0].arguments, hex"00");
        address created = _at(alice, 0, ORGANIZATION);
        vm.prank(alice);
        vm.expectRevert(
            abi.encodeWithSelector(IOrganizationRegistry.OtherArguments.selector, ORGANIZATION, created)
        );
        registry.create(LAB, 0, parts);
    }

    function test_whatAConstructorRefusesIsTold() public {
        // The task manager asks the organization, which is not there.
        Part[] memory parts = _parts(alice, 0, 0, 5);
        parts[0].arguments = abi.encode(new address[](1), new uint256[](0));
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(IECoin.LengthMismatch.selector, 1, 0));
        registry.create(LAB, 0, parts);
        assertEq(registry.organizationCount(), 0);
    }

    function test_whatWasCreatedHereIsKnownByItsArgumentsAndCode() public {
        _create(alice, 0, 0, 5);
        Part[] memory parts = _parts(alice, 0, 2, 3);
        assertEq(
            registry.initCodeHashOf(_at(alice, 0, ORGANIZATION)),
            keccak256(bytes.concat(parts[0].code, parts[0].arguments))
        );
        assertEq(registry.initCodeHashOf(alice), 0);
        assertEq(registry.initCodeHashOf(deployed("FirstComeFirstServed")), 0);
    }

    function test_everyPartHasAHash() public {
        vm.expectRevert(abi.encodeWithSelector(IOrganizationRegistry.HashesMissing.selector, 1, 2));
        deployed("OrganizationRegistry", abi.encode(new bytes32[](1), new bytes32[](2)));
    }

    function test_aCradleServesItsRegistryAlone() public {
        Cradle cradle = new Cradle();
        vm.prank(alice);
        vm.expectRevert(abi.encodeWithSelector(Cradle.NotRegistry.selector, alice));
        cradle.create(codes[1]);
    }

    function test_theAdministratorSetsUpInOneTransactionAndNobodyElseCould() public {
        _create(alice, 0, 0, 5);
        Organization organization = Organization(_at(alice, 0, ORGANIZATION));
        bytes[] memory calls = new bytes[](2);
        calls[0] = abi.encodeCall(organization.grantRole, (ORACLE_ROLE, bob));
        calls[1] = abi.encodeCall(organization.grantRole, (AUDITOR_ROLE, bob));
        vm.prank(bob);
        vm.expectRevert();
        organization.multicall(calls);
        vm.prank(alice);
        organization.multicall(calls);
        assertTrue(organization.hasRole(ORACLE_ROLE, bob));
        assertTrue(organization.hasRole(AUDITOR_ROLE, bob));
    }
}
