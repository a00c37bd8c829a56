// SPDX-License-Identifier: Apache-2.0
pragma solidity ^0.8.28;

import {IERC20Errors} from "@openzeppelin/contracts/interfaces/draft-IERC6093.sol";
import {Address} from "@openzeppelin/contracts/utils/Address.sol";
import {IDisputeJudge, InstanceRuling} from "../src/interfaces/IDisputeJudge.sol";
import {ChallengeRequest, ISignedRequests} from "../src/interfaces/ISignedRequests.sol";
import {Ruling, TaskRequest} from "../src/interfaces/ITaskManager.sol";
import {TaskId} from "../src/types/TaskId.sol";
import {Instances} from "./Instances.sol";
import {SignerWallet, Signing} from "./Signing.sol";

/// @notice Whom a signer names as the judge, and that sends the same request again.
contract Echo {
    bytes private _again;

    function listen(bytes calldata again) external {
        _again = again;
    }

    function challenge(TaskId, uint8, uint8, string calldata) external {
        Address.functionCall(msg.sender, _again);
    }
}

/// @notice Alice, robot1 and judges have no gas; a stranger sends what they sign.
contract RelayedChallengesTest is Instances {
    uint256 private constant NONCE = 7;

    ISignedRequests private requests;
    uint256 private deadline;

    function setUp() public override {
        super.setUp();
        requests = ISignedRequests(tasks.signedRequests());
        deadline = block.timestamp + 1 hours;
    }

    function test_theSignerIsTheChallengerAndPaysTheStake() public {
        TaskId taskId = ruled(Ruling.Accepted);
        (uint256 own, uint256 relayers) = (coin.balanceOf(alice), coin.balanceOf(stranger));
        vm.expectEmit(address(disputes));
        emit IDisputeJudge.Challenged(taskId, 0, alice, STAKE, block.timestamp + DECISION, "wrong");
        _relay("alice", _against(taskId, 1, 0));
        assertEq(coin.balanceOf(alice), own - STAKE);
        assertEq(coin.balanceOf(stranger), relayers);
        assertTrue(requests.isNonceUsed(alice, NONCE));
        decideSecond(taskId, Ruling.Rejected);
        skip(CHALLENGE + 1);
        disputes.settle(taskId, 1);
        assertEq(coin.balanceOf(alice), own, "it was right");
    }

    function test_aPartyTakesAJudgesChallengeOverWithoutGas() public {
        TaskId taskId = ruled(Ruling.Rejected);
        uint256 before = coin.balanceOf(judges[0]);
        challenge(judges[0], taskId);
        _relay("robot1", _against(taskId, 1, 0));
        assertEq(coin.balanceOf(judges[0]), before);
        (InstanceRuling[] memory rulings,,) = disputes.caseOf(taskId, 1);
        assertEq(rulings[0].challenger, robot1);
    }

    function test_aContractChallengesThatSignsByItsOwner() public {
        SignerWallet wallet = new SignerWallet(alice, coin, address(tasks));
        vm.prank(alice);
        coin.transfer(address(wallet), 500 ether);
        vm.prank(address(wallet));
        coin.approve(address(disputes), STAKE);
        offer(robot1, 80 ether);
        TaskRequest memory wanted = request(100 ether);
        wanted.verdictWindow = VERDICT_WINDOW;
        vm.prank(address(wallet));
        TaskId taskId = tasks.registerTask(wanted);
        submit(taskId);
        first(taskId, Ruling.Accepted);
        ChallengeRequest memory r = _against(taskId, 1, 0);
        (, uint256 key) = makeAddrAndKey("alice");
        bytes memory signature =
            Signing.challenge(key, address(requests), address(wallet), r, NONCE, deadline);
        requests.challengeFor(address(wallet), r, NONCE, deadline, signature);
        assertEq(coin.balanceOf(address(wallet)), 400 ether - STAKE);
    }

    // -- attacks --------------------------------------------------------------------------------------------

    function test_attack_aChallengeIsSentTwiceOrAfterItWasRevokedOrTooLate() public {
        TaskId taskId = ruled(Ruling.Accepted);
        ChallengeRequest memory r = _against(taskId, 1, 0);
        bytes memory signature = _signed("alice", r);
        vm.prank(alice);
        requests.revokeRequest(NONCE);
        bytes memory used = abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE);
        vm.expectRevert(used);
        requests.challengeFor(alice, r, NONCE, deadline, signature);
        signature = _signedWith("alice", r, NONCE + 1);
        requests.challengeFor(alice, r, NONCE + 1, deadline, signature);
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE + 1));
        requests.challengeFor(alice, r, NONCE + 1, deadline, signature);
        vm.warp(deadline + 1);
        vm.expectRevert(
            abi.encodeWithSelector(ISignedRequests.RequestExpired.selector, deadline, deadline + 1)
        );
        requests.challengeFor(alice, r, NONCE + 2, deadline, signature);
    }

    /// @dev No word of what was signed can be another one.
    function test_attack_aChallengeIsSentToAnotherJudgeOrAgainstAnotherRuling() public {
        TaskId taskId = ruled(Ruling.Accepted);
        bytes memory signature = _signed("alice", _against(taskId, 1, 0));
        ChallengeRequest[5] memory others;
        for (uint256 i = 0; i < others.length; ++i) {
            others[i] = _against(taskId, 1, 0);
        }
        others[0].judge = deployed("DisputeJudge", abi.encode(organization, address(auditorJudge)));
        others[1].taskId = following(taskId);
        others[2].attempt = 2;
        others[3].instance = 1;
        others[4].reason = "I was paid for this";
        for (uint256 i = 0; i < others.length; ++i) {
            vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, alice));
            requests.challengeFor(alice, others[i], NONCE, deadline, signature);
        }
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NotSignedBy.selector, bob));
        requests.challengeFor(bob, _against(taskId, 1, 0), NONCE, deadline, signature);
    }

    /// @dev A relayer that waits makes nobody challenge what it likes.
    function test_attack_aChallengeComesLateAndMeetsTheNextRuling() public {
        TaskId taskId = ruled(Ruling.Accepted);
        ChallengeRequest memory r = _against(taskId, 1, 0);
        bytes memory signature = _signed("alice", r);
        challenge(judges[0], taskId);
        decideSecond(taskId, Ruling.Rejected);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.AnotherRuling.selector, taskId, 1, 1));
        requests.challengeFor(alice, r, NONCE, deadline, signature);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.AnotherRuling.selector, taskId, 1, 1));
        vm.prank(alice);
        disputes.challenge(taskId, 2, 1, "wrong");
        assertFalse(requests.isNonceUsed(alice, NONCE));
    }

    function test_attack_whoSignsIsNeitherPartyNorJudge() public {
        TaskId taskId = ruled(Ruling.Accepted);
        ChallengeRequest memory r = _against(taskId, 1, 0);
        bytes memory signature = _signed("stranger", r);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NeitherPartyNorJudge.selector, taskId, stranger));
        requests.challengeFor(stranger, r, NONCE, deadline, signature);
    }

    function test_attack_aCallerAppendsAPartysAddress() public {
        TaskId taskId = ruled(Ruling.Accepted);
        bytes memory call = abi.encodeCall(IDisputeJudge.challenge, (taskId, 1, 0, "wrong"));
        vm.prank(stranger);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NeitherPartyNorJudge.selector, taskId, stranger));
        Address.functionCall(address(disputes), bytes.concat(call, bytes20(alice)));
    }

    /// @dev What the signed requests' contract does not say is believed nowhere else either.
    function test_attack_theForwarderIsBelievedForChallengesAlone() public {
        address forwarder = address(requests);
        bytes memory call = abi.encodeCall(IDisputeJudge.announceWithdrawal, (committee, 0, 1));
        vm.prank(forwarder);
        vm.expectRevert(abi.encodeWithSelector(IDisputeJudge.NotOwner.selector, forwarder, judges[0]));
        Address.functionCall(address(disputes), bytes.concat(call, bytes20(judges[0])));
        call = abi.encodeCall(IDisputeJudge.depositStake, (committee, 0, 1 ether));
        vm.prank(forwarder);
        vm.expectRevert(
            abi.encodeWithSelector(IERC20Errors.ERC20InsufficientAllowance.selector, disputes, 0, 1 ether)
        );
        Address.functionCall(address(disputes), bytes.concat(call, bytes20(alice)));
    }

    function test_attack_theJudgeThatIsNamedIsNone() public {
        ChallengeRequest memory r = _against(ruled(Ruling.Accepted), 1, 0);
        address[3] memory others = [address(tasks), address(requests), address(coin)];
        for (uint256 i = 0; i < others.length; ++i) {
            r.judge = others[i];
            bytes memory signature = _signed("alice", r);
            vm.expectRevert();
            requests.challengeFor(alice, r, NONCE, deadline, signature);
        }
        r.judge = bob;
        bytes memory nobody = _signed("alice", r);
        vm.expectRevert(abi.encodeWithSelector(Address.AddressEmptyCode.selector, bob));
        requests.challengeFor(alice, r, NONCE, deadline, nobody);
        assertFalse(requests.isNonceUsed(alice, NONCE));
    }

    function test_attack_theJudgeThatIsNamedSendsTheRequestAgain() public {
        Echo echo = new Echo();
        ChallengeRequest memory r = _against(ruled(Ruling.Accepted), 1, 0);
        r.judge = address(echo);
        bytes memory signature = _signed("alice", r);
        echo.listen(abi.encodeCall(ISignedRequests.challengeFor, (alice, r, NONCE, deadline, signature)));
        vm.expectRevert(abi.encodeWithSelector(ISignedRequests.NonceUsed.selector, alice, NONCE));
        requests.challengeFor(alice, r, NONCE, deadline, signature);
    }

    function test_attack_whoHasGivenNoAllowanceLosesNothing() public {
        ChallengeRequest memory r = _against(ruled(Ruling.Accepted), 1, 0);
        vm.prank(alice);
        coin.approve(address(disputes), STAKE - 1);
        bytes memory signature = _signed("alice", r);
        vm.expectPartialRevert(IERC20Errors.ERC20InsufficientAllowance.selector);
        requests.challengeFor(alice, r, NONCE, deadline, signature);
        assertFalse(requests.isNonceUsed(alice, NONCE));
    }

    /// @dev With too little gas nothing happens, or all of it: the stake that goes back is paid, or owed.
    function test_attack_theRelayerStarvesTheChallenge() public {
        TaskId taskId = ruled(Ruling.Rejected);
        uint256 before = coin.balanceOf(judges[0]);
        challenge(judges[0], taskId);
        ChallengeRequest memory r = _against(taskId, 1, 0);
        bytes memory signature = _signed("robot1", r);
        bytes memory call =
            abi.encodeCall(ISignedRequests.challengeFor, (robot1, r, NONCE, deadline, signature));
        uint256 done = 0;
        for (uint256 gas = 20_000; gas < 600_000; gas += 10_000) {
            uint256 snapshot = vm.snapshotState();
            (bool success,) = address(requests).call{gas: gas}(call);
            assertEq(requests.isNonceUsed(robot1, NONCE), success, "a nonce for nothing");
            if (success) {
                ++done;
                uint256 owed = disputes.pendingPayments(judges[0]);
                assertEq(coin.balanceOf(judges[0]) + owed, before, "a stake is lost");
                assertEq(coin.balanceOf(address(disputes)), STAKE + owed);
            }
            vm.revertToState(snapshot);
        }
        assertGt(done, 10);
    }

    function _against(TaskId taskId, uint8 number, uint8 instance_)
        private
        view
        returns (ChallengeRequest memory)
    {
        return ChallengeRequest(address(disputes), taskId, number, instance_, "wrong");
    }

    function _signed(string memory who, ChallengeRequest memory r) private returns (bytes memory) {
        return _signedWith(who, r, NONCE);
    }

    function _signedWith(string memory who, ChallengeRequest memory r, uint256 nonce)
        private
        returns (bytes memory)
    {
        (address signer, uint256 key) = makeAddrAndKey(who);
        return Signing.challenge(key, address(requests), signer, r, nonce, deadline);
    }

    function _relay(string memory who, ChallengeRequest memory r) private {
        bytes memory signature = _signed(who, r);
        vm.prank(stranger);
        requests.challengeFor(makeAddr(who), r, NONCE, deadline, signature);
    }
}
