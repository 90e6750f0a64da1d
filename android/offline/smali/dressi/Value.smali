.class public final Ldressi/Value;
.super Ljava/lang/Object;


# static fields
.field public static final IN:I = 0x0

.field public static final OUT:I = 0x2

.field public static final STATE:I = 0x1


# instance fields
.field public final channels:I

.field public final isInt:Z

.field public final name:Ljava/lang/String;

.field public final role:I

.field final shape:[I


# direct methods
.method constructor <init>(Ljava/lang/String;[I)V
    .registers 7

    const/4 v0, 0x1

    const/4 v1, 0x0

    invoke-direct {p0}, Ljava/lang/Object;-><init>()V

    iput-object p1, p0, Ldressi/Value;->name:Ljava/lang/String;

    aget v2, p2, v1

    iput v2, p0, Ldressi/Value;->role:I

    aget v2, p2, v0

    if-eqz v2, :cond_27

    :goto_f
    iput-boolean v0, p0, Ldressi/Value;->isInt:Z

    const/4 v0, 0x2

    aget v0, p2, v0

    iput v0, p0, Ldressi/Value;->channels:I

    array-length v0, p2

    add-int/lit8 v0, v0, -0x3

    new-array v0, v0, [I

    iput-object v0, p0, Ldressi/Value;->shape:[I

    const/4 v0, 0x3

    iget-object v2, p0, Ldressi/Value;->shape:[I

    iget-object v3, p0, Ldressi/Value;->shape:[I

    array-length v3, v3

    invoke-static {p2, v0, v2, v1, v3}, Ljava/lang/System;->arraycopy(Ljava/lang/Object;ILjava/lang/Object;II)V

    return-void

    :cond_27
    move v0, v1

    goto :goto_f
.end method


# virtual methods
.method public buffer()Ljava/nio/ByteBuffer;
    .registers 3

    invoke-virtual {p0}, Ldressi/Value;->bytes()I

    move-result v0

    invoke-static {v0}, Ljava/nio/ByteBuffer;->allocateDirect(I)Ljava/nio/ByteBuffer;

    move-result-object v0

    invoke-static {}, Ljava/nio/ByteOrder;->nativeOrder()Ljava/nio/ByteOrder;

    move-result-object v1

    invoke-virtual {v0, v1}, Ljava/nio/ByteBuffer;->order(Ljava/nio/ByteOrder;)Ljava/nio/ByteBuffer;

    move-result-object v0

    return-object v0
.end method

.method public bytes()I
    .registers 9

    const-wide/16 v2, 0x4

    iget-object v1, p0, Ldressi/Value;->shape:[I

    array-length v4, v1

    const/4 v0, 0x0

    :goto_6
    if-ge v0, v4, :cond_f

    aget v5, v1, v0

    int-to-long v6, v5

    mul-long/2addr v2, v6

    add-int/lit8 v0, v0, 0x1

    goto :goto_6

    :cond_f
    const-wide/32 v0, 0x7fffffff

    cmp-long v0, v2, v0

    if-lez v0, :cond_3c

    new-instance v0, Ldressi/DressiException;

    const/4 v1, 0x1

    new-instance v4, Ljava/lang/StringBuilder;

    invoke-direct {v4}, Ljava/lang/StringBuilder;-><init>()V

    iget-object v5, p0, Ldressi/Value;->name:Ljava/lang/String;

    invoke-virtual {v4, v5}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v4

    const-string v5, " has "

    invoke-virtual {v4, v5}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v4

    invoke-virtual {v4, v2, v3}, Ljava/lang/StringBuilder;->append(J)Ljava/lang/StringBuilder;

    move-result-object v2

    const-string v3, " bytes; a buffer has less"

    invoke-virtual {v2, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v2

    invoke-virtual {v2}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v2

    invoke-direct {v0, v1, v2}, Ldressi/DressiException;-><init>(ILjava/lang/String;)V

    throw v0

    :cond_3c
    long-to-int v0, v2

    return v0
.end method

.method public shape()[I
    .registers 2

    iget-object v0, p0, Ldressi/Value;->shape:[I

    invoke-virtual {v0}, [I->clone()Ljava/lang/Object;

    move-result-object v0

    check-cast v0, [I

    return-object v0
.end method
