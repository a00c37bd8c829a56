// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {SignedRequests} from "../src/SignedRequests.sol";
import {IOrganization} from "../src/interfaces/IOrganization.sol";
import {ISignedRequests} from "../src/interfaces/ISignedRequests.sol";
import {Fault, ITaskManager, TaskRequest, TaskState, Ruling} from "../src/interfaces/ITaskManager.sol";
import {Finding, IJudge} from "../src/interfaces/IJudge.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {MEMBER_ROLE, ORACLE_ROLE} from "../src/types/Roles.sol";
import {Fixture} from "./Fixture.sol";
import {SignerWallet, Signing} from "./Signing.sol";

/// @notice Alice and robot1 have no gas; a stranger sends what they sign.
contract SignedRequestsTest is Fixture {
    uint256 private constant NONCE = 7;

    SignedRequests private requests;
    uint256 private deadline;

    function setUp() public override {
        super.setUp();
        requests = SignedRequests(tasks.signedRequests());
        deadline = block.timestamp + 1 hours;
    }

    // -- a relayer pays the gas, and nothing else -----------------------------------------------------------

    function test_theSignerIsTheCreatorAndPaysTheReward() public {
        offer(robot1, 80 ether);
        vm.expectEmit(address(requests));
        emit ISignedRequests.RequestUsed(alice, NONCE, taskNo(1), stranger);
        TaskId taskId = _relay(alice, NONCE);
        assertEq(tasks.task(taskId).creator, alice);
        assertEq(coin.balanceOf(alice), 1900 ether);
        assertAssigned(taskId, serviceNo(1));
        assertTrue(requests.isNonceUsed(alice, NONCE));
    }

    function test_aRelayedProofIsTheExecutorsAndIsPaid() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        _relayProof(robot1, taskId, 1, PROOF);
        assertState(taskId, TaskState.Submitted);
        assertEq(tasks.task(taskId).proofHash, PROOF);
        judge(taskId, true);
        assertEq(coin.balanceOf(robot1), 2080 ether);
    }

    function test_aContractIsAMember() public {
        SignerWallet wallet = _wallet(alice);
        vm.startPrank(admin);
        organization.setMembersOnly(true);
        organization.grantRole(MEMBER_ROLE, address(wallet));
        vm.stopPrank();
        TaskId taskId = _relayFor(address(wallet), alice, NONCE);
        assertEq(tasks.task(taskId).creator, address(wallet));
        assertEq(coin.balanceOf(address(wallet)), 400 ether);
    }

    function test_theCreatorCancelsWithoutGas() public {
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature =
            Signing.cancellation(_key(alice), address(requests), alice, taskId, NONCE, deadline);
        vm.prank(stranger);
        requests.cancelTaskFor(alice, taskId, NONCE, deadline, signature);
        assertState(taskId, TaskState.Cancelled);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }

    function test_theExecutorAcceptsAndGivesBackWithoutGas() public {
        vm.prank(robot1);
        services.registerService(CLEANING, 80 ether, NO_LIMIT, false, "");
        TaskId taskId = post(alice, 100 ether);
        vm.expectEmit(address(tasks));
        emit ITaskManager.TaskAccepted(taskId, 1, robot1);
        _accept(robot1, taskId, 1);
        _abandon(robot1, taskId, 1, NONCE + 1);
        assertState(taskId, TaskState.Open);
    }

    function test_attack_anotherThanTheExecutorAcceptsOrGivesBack() public {
        vm.prank(robot1);
        services.registerService(CLEANING, 80 ether, NO_LIMIT, false, "");
        TaskId taskId = post(alice, 100 ether);
        bytes memory reason = abi.encodeWithSelector(ITaskManager.NotExecutor.selector, taskId, bob, robot1);
        bytes memory signature = _attemptSignature("AcceptTask", bob, taskId, 1, NONCE);
        vm.expectRevert(reason);
        requests.acceptTaskFor(bob, taskId, 1, NONCE, deadline, signature);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, robot1));
        requests.acceptTaskFor(robot1, taskId, 1, NONCE, deadline, signature);
        signature = _attemptSignature("AbandonTask", bob, taskId, 1, NONCE);
        vm.expectRevert(reason);
        requests.abandonTaskFor(bob, taskId, 1, NONCE, deadline, signature);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, robot1));
        requests.abandonTaskFor(robot1, taskId, 1, NONCE, deadline, signature);
        // What is signed is one of the two.
        signature = _attemptSignature("AcceptTask", robot1, taskId, 1, NONCE);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, robot1));
        requests.abandonTaskFor(robot1, taskId, 1, NONCE, deadline, signature);
    }

    function test_whatIsSignedCountsOnce() public {
        vm.prank(robot1);
        services.registerService(CLEANING, 80 ether, NO_LIMIT, false, "");
        TaskId taskId = post(alice, 100 ether);
        _accept(robot1, taskId, 1);
        bytes memory again = _attemptSignature("AcceptTask", robot1, taskId, 1, NONCE);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, robot1, NONCE));
        requests.acceptTaskFor(robot1, taskId, 1, NONCE, deadline, again);
        again = _attemptSignature("AbandonTask", robot1, taskId, 1, NONCE);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, robot1, NONCE));
        requests.abandonTaskFor(robot1, taskId, 1, NONCE, deadline, again);
        _abandon(robot1, taskId, 1, NONCE + 1);
        again = _attemptSignature("AbandonTask", robot1, taskId, 2, NONCE + 1);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, robot1, NONCE + 1));
        requests.abandonTaskFor(robot1, taskId, 2, NONCE + 1, deadline, again);
    }

    function test_whatIsSignedIsRevokedWhateverItIs() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        TaskId open = post(alice, 100 ether);
        bytes memory proof = _proofSignature(robot1, taskId, 1, PROOF);
        bytes memory back = _attemptSignature("AbandonTask", robot1, taskId, 1, NONCE);
        bytes memory cancelled =
            Signing.cancellation(_key(alice), address(requests), alice, open, NONCE, deadline);
        vm.prank(robot1);
        requests.revokeRequest(NONCE);
        vm.prank(alice);
        requests.revokeRequest(NONCE);
        bytes memory reason = abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, robot1, NONCE);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskId, 1, PROOF, URI, NONCE, deadline, proof);
        vm.expectRevert(reason);
        requests.abandonTaskFor(robot1, taskId, 1, NONCE, deadline, back);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE));
        requests.cancelTaskFor(alice, open, NONCE, deadline, cancelled);
    }

    function test_requestsCountInAnyOrder() public {
        _relay(alice, 300);
        _relay(alice, 2);
        _relay(alice, 1);
        assertEq(tasks.taskCount(), 3);
    }

    // -- a signature says what it says, once ----------------------------------------------------------------

    function test_attack_aRequestIsSentAgain() public {
        _relay(alice, NONCE);
        _mustFail(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE));
        assertEq(coin.balanceOf(alice), 1900 ether);
    }

    function test_attack_aRevokedRequestIsSent() public {
        vm.expectEmit(address(requests));
        emit ISignedRequests.RequestRevoked(alice, NONCE);
        vm.prank(alice);
        requests.revokeRequest(NONCE);
        _mustFail(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE));
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE));
        vm.prank(alice);
        requests.revokeRequest(NONCE);
    }

    function test_attack_aStrangerUsesUpANonce() public {
        vm.prank(stranger);
        requests.revokeRequest(NONCE);
        _relay(alice, NONCE);
    }

    function test_attack_aRelayerKeepsARequestUntilItsDeadline() public {
        vm.warp(deadline);
        _relay(alice, NONCE);
        vm.warp(deadline + 1);
        bytes memory signature = _signature(alice, alice, NONCE + 1);
        vm.expectRevert(
            abi.encodeWithSelector(ISignedRequests.RequestExpired.selector, deadline, deadline + 1)
        );
        vm.prank(stranger);
        requests.registerTaskFor(alice, request(100 ether), NONCE + 1, deadline, signature);
    }

    function test_attack_aRelayerChangesTheRequest() public {
        bytes memory signature = _signature(alice, alice, NONCE);
        for (uint256 i = 0; i < 11; ++i) {
            (TaskRequest memory r, uint256 nonce, uint256 end) = (request(100 ether), NONCE, deadline);
            if (i == 0) r.kind = CHARGING;
            if (i == 1) r.reward += 1;
            if (i == 2) r.executionWindow += 1;
            if (i == 3) r.verdictWindow += 1;
            if (i == 4) r.maxAttempts -= 1;
            if (i == 5) r.rules = RULES;
            if (i == 6) r.serviceId = 1;
            if (i == 7) r.params = "{ }";
            if (i == 8) nonce += 1;
            if (i == 9) end += 1;
            if (i == 10) r.provider = bob;
            vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, alice));
            vm.prank(stranger);
            requests.registerTaskFor(alice, r, nonce, end, signature);
        }
    }

    /// @dev EIP-7702: code that knows no ERC-1271 stands where an account's key has delegated to it.
    function test_theKeyOfAnAccountWithCodeSignsForIt() public {
        vm.etch(alice, address(coin).code);
        bytes memory signature = _signature(alice, alice, NONCE);
        vm.prank(stranger);
        assertState(
            requests.registerTaskFor(alice, request(100 ether), NONCE, deadline, signature), TaskState.Open
        );
    }

    function test_attack_nobodySignsForTheZeroAddressOrForAnAccountWithCode() public {
        vm.etch(alice, address(coin).code);
        address[2] memory signers = [address(0), alice];
        for (uint256 i = 0; i < signers.length; i++) {
            bytes[3] memory forged = [bytes(""), new bytes(65), _signature(bob, signers[i], NONCE)];
            for (uint256 j = 0; j < forged.length; j++) {
                vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, signers[i]));
                requests.registerTaskFor(signers[i], request(100 ether), NONCE, deadline, forged[j]);
            }
        }
    }

    function test_attack_aRelayerChangesTheProof() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature = _proofSignature(robot1, taskId, 1, PROOF);
        bytes memory reason = abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, robot1);
        vm.startPrank(stranger);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskId, 1, REPORT, URI, NONCE, deadline, signature);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskId, 1, PROOF, "elsewhere", NONCE, deadline, signature);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskId, 1, PROOF, URI, NONCE, deadline + 1, signature);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskId, 1, PROOF, URI, NONCE + 1, deadline, signature);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskId, 2, PROOF, URI, NONCE, deadline, signature);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, following(taskId), 1, PROOF, URI, NONCE, deadline, signature);
        vm.stopPrank();
    }

    function test_attack_onAnotherChainOrInAnotherOrganization() public {
        bytes memory signature = _signature(alice, alice, NONCE);
        vm.chainId(block.chainid + 1);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, alice));
        requests.registerTaskFor(alice, request(100 ether), NONCE, deadline, signature);
        vm.chainId(block.chainid - 1);

        found(coin);
        vm.prank(alice);
        coin.approve(address(tasks), type(uint256).max);
        ISignedRequests others = ISignedRequests(tasks.signedRequests());
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, alice));
        others.registerTaskFor(alice, request(100 ether), NONCE, deadline, signature);
    }

    function test_attack_theSameKeySignsForAnotherContract() public {
        SignerWallet one = _wallet(alice);
        SignerWallet other = _wallet(alice);
        bytes memory signature = _signature(alice, address(one), NONCE);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, address(other)));
        requests.registerTaskFor(address(other), request(100 ether), NONCE, deadline, signature);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, alice));
        requests.registerTaskFor(alice, request(100 ether), NONCE, deadline, signature);
        requests.registerTaskFor(address(one), request(100 ether), NONCE, deadline, signature);
    }

    function testFuzz_attack_garbageIsNobodysSignature(bytes calldata garbage, address signer) public {
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, signer));
        requests.registerTaskFor(signer, request(0), NONCE, deadline, garbage);
    }

    function test_attack_theContractsOfTheOrganizationSignNothing() public {
        bytes memory signature = _signature(alice, address(organization), NONCE);
        address[4] memory contracts =
            [address(organization), address(tasks), address(services), address(requests)];
        for (uint256 i = 0; i < contracts.length; ++i) {
            vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, contracts[i]));
            requests.registerTaskFor(contracts[i], request(100 ether), NONCE, deadline, signature);
        }
    }

    // -- what fails uses nothing up -------------------------------------------------------------------------

    function test_attack_aRequestThatFailsIsValidLater() public {
        vm.prank(alice);
        coin.approve(address(tasks), 0);
        _mustFail(
            abi.encodeWithSelector(
                IERC20Errors.ERC20InsufficientAllowance.selector, address(tasks), 0, 100 ether
            )
        );
        assertFalse(requests.isNonceUsed(alice, NONCE));
        vm.prank(alice);
        coin.approve(address(tasks), 100 ether);
        _relay(alice, NONCE);
    }

    /// @dev With any amount, all of it happens, assignment by the policy included, or nothing.
    function testFuzz_attack_aRelayerGivesLittleGas(uint256 gas) public {
        offer(robot1, 80 ether);
        bytes memory signature = _signature(alice, alice, NONCE);
        gas = bound(gas, 20_000, 700_000);
        vm.prank(stranger);
        try requests.registerTaskFor{gas: gas}(
            alice, request(100 ether), NONCE, deadline, signature
        ) returns (
            TaskId taskId
        ) {
            assertAssigned(taskId, serviceNo(1));
        } catch {
            assertFalse(requests.isNonceUsed(alice, NONCE));
            assertEq(tasks.taskCount(), 0);
            assertEq(coin.balanceOf(alice), 2000 ether);
        }
    }

    function testFuzz_attack_aRelayerGivesAProofLittleGas(uint256 gas) public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature = _proofSignature(robot1, taskId, 1, PROOF);
        gas = bound(gas, 20_000, 200_000);
        try requests.submitProofFor{gas: gas}(robot1, taskId, 1, PROOF, URI, NONCE, deadline, signature) {}
        catch {
            assertState(taskId, TaskState.Assigned);
            requests.submitProofFor(robot1, taskId, 1, PROOF, URI, NONCE, deadline, signature);
        }
        assertState(taskId, TaskState.Submitted);
    }

    // -- the signer's rights, as they are now ---------------------------------------------------------------

    function test_attack_theSignerIsNoMemberAnyMore() public {
        vm.startPrank(admin);
        organization.setMembersOnly(true);
        organization.grantRole(MEMBER_ROLE, alice);
        organization.grantRole(MEMBER_ROLE, stranger);
        organization.revokeRole(MEMBER_ROLE, alice);
        vm.stopPrank();
        _mustFail(abi.encodeWithSelector(IOrganization.NotMember.selector, alice));
        assertFalse(requests.isNonceUsed(alice, NONCE));
    }

    function test_attack_anotherThanTheExecutorSigns() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature = _proofSignature(robot2, taskId, 1, PROOF);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotExecutor.selector, taskId, robot2, robot1));
        vm.prank(robot1);
        requests.submitProofFor(robot2, taskId, 1, PROOF, URI, NONCE, deadline, signature);
    }

    function test_attack_aProofOfAnEarlierAttemptIsSent() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature = _proofSignature(robot1, taskId, 1, PROOF);
        skip(GRACE + 1);
        vm.prank(robot1);
        tasks.abandonTask(taskId, 1);
        assertAssigned(taskId, serviceNo(1));
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.WrongAttempt.selector, taskId, 2, 1));
        requests.submitProofFor(robot1, taskId, 1, PROOF, URI, NONCE, deadline, signature);
    }

    function test_attack_aRelayedProofIsReplaced() public {
        offer(robot1, 80 ether);
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature = _proofSignature(robot1, taskId, 1, REPORT);
        _relayProof(robot1, taskId, 1, PROOF);
        vm.expectRevert(
            abi.encodeWithSelector(
                ITaskManager.WrongState.selector, taskId, TaskState.Submitted, TaskState.Assigned
            )
        );
        requests.submitProofFor(robot1, taskId, 1, REPORT, URI, NONCE, deadline, signature);
    }

    function test_attack_aProofOrACancellationIsSentTooLate() public {
        vm.warp(deadline + 1);
        bytes memory reason =
            abi.encodeWithSelector(ISignedRequests.RequestExpired.selector, deadline, deadline + 1);
        vm.expectRevert(reason);
        requests.submitProofFor(robot1, taskNo(1), 1, PROOF, URI, NONCE, deadline, "");
        vm.expectRevert(reason);
        requests.cancelTaskFor(alice, taskNo(1), NONCE, deadline, "");
        vm.expectRevert(reason);
        requests.acceptTaskFor(robot1, taskNo(1), 1, NONCE, deadline, "");
        vm.expectRevert(reason);
        requests.abandonTaskFor(robot1, taskNo(1), 1, NONCE, deadline, "");
    }

    function test_attack_anotherThanTheCreatorCancels() public {
        TaskId taskId = post(alice, 100 ether);
        bytes memory signature =
            Signing.cancellation(_key(bob), address(requests), bob, taskId, NONCE, deadline);
        vm.expectRevert(abi.encodeWithSelector(ITaskManager.NotCreator.selector, taskId, bob, alice));
        requests.cancelTaskFor(bob, taskId, NONCE, deadline, signature);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, alice));
        requests.cancelTaskFor(alice, taskId, NONCE, deadline, signature);
    }

    function test_attack_aJudgeSignsATaskThatItJudges() public {
        vm.startPrank(admin);
        organization.grantRole(ORACLE_ROLE, alice);
        organization.grantRole(ORACLE_ROLE, stranger);
        vm.stopPrank();
        offer(robot1, 80 ether);
        TaskId taskId = _relay(alice, NONCE);
        submit(taskId);
        vm.expectRevert(abi.encodeWithSelector(IJudge.JudgeIsParty.selector, taskId, alice));
        vm.prank(alice);
        oracleJudge.rule(
            Finding(taskId, 1, PROOF, REPORT, RULES, Ruling.Rejected, Fault.Nobody, 0, "because"), "report"
        );
        // Who relayed it is no party.
        judgeAs(stranger, taskId, Ruling.Accepted, 80 ether);
        assertState(taskId, TaskState.Settled);
    }

    // -- nobody else speaks for others ----------------------------------------------------------------------

    function test_attack_aStrangerAppendsAnothersAddress() public {
        bytes memory call = abi.encodeCall(ITaskManager.registerTask, (request(100 ether)));
        vm.prank(bob);
        (bool success,) = address(tasks).call(bytes.concat(call, bytes20(alice)));
        assertTrue(success);
        assertEq(tasks.task(taskNo(1)).creator, bob);
        assertEq(coin.balanceOf(alice), 2000 ether);
    }

    function test_attack_anotherContractOfTheSameCodeIsNotBelieved() public {
        SignedRequests copy = SignedRequests(deployed("SignedRequests"));
        assertEq(address(copy.tasks()), address(this));
        assertEq(address(requests.tasks()), address(tasks));
    }

    // -- helpers --------------------------------------------------------------------------------------------

    function _relay(address creator, uint256 nonce) private returns (TaskId taskId) {
        return _relayFor(creator, creator, nonce);
    }

    function _relayFor(address creator, address signer, uint256 nonce) private returns (TaskId taskId) {
        bytes memory signature = _signature(signer, creator, nonce);
        vm.prank(stranger);
        return requests.registerTaskFor(creator, request(100 ether), nonce, deadline, signature);
    }

    function _mustFail(bytes memory reason) private {
        bytes memory signature = _signature(alice, alice, NONCE);
        vm.expectRevert(reason);
        vm.prank(stranger);
        requests.registerTaskFor(alice, request(100 ether), NONCE, deadline, signature);
    }

    function _relayProof(address executor, TaskId taskId, uint8 attempt_, bytes32 proofHash) private {
        bytes memory signature = _proofSignature(executor, taskId, attempt_, proofHash);
        vm.prank(stranger);
        requests.submitProofFor(executor, taskId, attempt_, proofHash, URI, NONCE, deadline, signature);
    }

    function _signature(address signer, address creator, uint256 nonce) private returns (bytes memory) {
        return
            Signing.registration(
                _key(signer), address(requests), creator, request(100 ether), nonce, deadline
            );
    }

    function _proofSignature(address executor, TaskId taskId, uint8 attempt_, bytes32 proofHash)
        private
        returns (bytes memory)
    {
        return Signing.proof(
            _key(executor), address(requests), executor, taskId, attempt_, proofHash, URI, NONCE, deadline
        );
    }

    function _attemptSignature(string memory name, address signer, TaskId taskId, uint8 number, uint256 nonce)
        private
        returns (bytes memory)
    {
        uint256 key = _key(signer);
        return Signing.attempt(name, key, address(requests), signer, taskId, number, nonce, deadline);
    }

    function _accept(address executor, TaskId taskId, uint8 number) private {
        bytes memory signature = _attemptSignature("AcceptTask", executor, taskId, number, NONCE);
        vm.prank(stranger);
        requests.acceptTaskFor(executor, taskId, number, NONCE, deadline, signature);
    }

    function _abandon(address executor, TaskId taskId, uint8 number, uint256 nonce) private {
        bytes memory signature = _attemptSignature("AbandonTask", executor, taskId, number, nonce);
        vm.prank(stranger);
        requests.abandonTaskFor(executor, taskId, number, nonce, deadline, signature);
    }

    function _wallet(address owner) private returns (SignerWallet wallet) {
        wallet = new SignerWallet(owner, coin, address(tasks));
        vm.prank(bob);
        assertTrue(coin.transfer(address(wallet), 500 ether));
    }

    function _key(address who) private returns (uint256 key) {
        string[4] memory names = ["alice", "bob", "robot1", "robot2"];
        for (uint256 i = 0; i < names.length; ++i) {
            (address account, uint256 found_) = makeAddrAndKey(names[i]);
            if (account == who) return found_;
        }
    }
}
